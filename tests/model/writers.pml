/* One region: a Python process P and a PLC L that both want to write it, and a reader R in Python.
 *
 * Slots, lock, healing, claim and the change of writers, loads and stores one by one; what the lock keeps in its words
 * is one step with its semaphore here (lock.pml has them one by one). Each end may stand still for a second or more
 * (STALLS) or die (CRASHES) at any step.
 *
 * Time: a second passes only while nobody who runs is at work, because a write or a read takes far less; the same for
 * the tenth of a second in which a name must stand.
 */
#define WRITER    0
#define BEGUN     1
#define COMPLETED 2
#define BEAT      3
#define HOLDER    4
#define COUNT     5
#define RECOV     6
#define SLOT0     7  /* number, two halves of the payload; slot 1 after it */
#define PAIR      13 /* begun and completed in one */
#define WORDS     14
#define NUMBER(n)  (SLOT0 + 3 * ((n) % 2))
#define HALF1(n)   (NUMBER(n) + 1)
#define HALF2(n)   (NUMBER(n) + 2)

#define P 0
#define L 1
#define R 2
#define ENDS 3    /* what R stores, the words of the lock, it stores inside it: its buffer stays empty */
#include "memory.pml"

#ifndef PUBLISHES
#define PUBLISHES 2   /* tries of P to write, each time it is open */
#endif
#ifndef OPENS
#ifdef START_P
#define OPENS 0
#endif
#endif
#ifndef OPENS
#define OPENS 1       /* times P is opened */
#endif
#ifndef CYCLES
#define CYCLES 4      /* of L */
#endif
#ifndef READS
#define READS 2
#endif
#ifndef STALLS
#define STALLS 1
#endif
#ifndef CRASHES
#define CRASHES 0
#endif
#ifndef CLOSES
#define CLOSES 0      /* times L is disabled and enabled again */
#endif

/* Today's protocol, before the mends. */
#ifdef F_TODAY
#define F_NO_LOOK
#define F_NO_VOID
#define F_NO_CONFIRM
#define F_NUMBER_FROM_COMPLETED
#define F_CLOSE_ANY
#define F_SHORT_WATCH
#define F_BEAT_ONLY
#define F_NUMBER_BEFORE_COPY
#endif

byte sem = 1;
byte stalls = STALLS, crashes = CRASHES;

/* What no end can see. */
bit busy[3];      /* at work */
bit stalled[3];
bit dead[3];
bit slept[3];     /* stood still since it began what it does */
bit zone[3];      /* between its look at the claim and the look after its copy */
bit cycled;       /* L has made a cycle since P began to watch it */
bit ended[3];
bit late;         /* a writer has stored something after it lost the topic: a sample may be hidden until the next */
byte excl;        /* 1 + who has stood still inside its copy and now runs to the end of it at once, see docs/protocol.md */
byte tags;        /* number of writes, which tells one from the other */

/* Numbers have four bits here; after the last comes 2, the number of slots. */
#define LAST 15
#define NEXT(n) ((n) == LAST -> 2 : (n) + 1)
#define TURN(n) ((n) + 2 > LAST -> (n) + 2 - LAST - 1 + 2 : (n) + 2)   /* one turn of the slots later */
#define DISTANCE(s, b) ((b) >= (s) -> (b) - (s) : (b) + LAST + 1 - 2 - (s))
#define NEWER(x, c) ((x) != 0 && ((x) + LAST + 1 - (c)) % (LAST + 1) <= LAST / 2)
#ifdef WRAP
#define NEWEST 14  /* the sample that is there already, see init */
#else
#define NEWEST 1
#endif

/* The number that follows c is not used twice: the writer before may have filled the slot, and may still complete it.
 * 0: nothing of that. */
#if defined(F_NO_LEAP) || defined(F_LEAPS_ALWAYS)
#define FIRST(p, c) 0
#else
#define FIRST(p, c) (NEWER(LD(p, NUMBER(NEXT(c))), c) -> TURN(LD(p, NUMBER(NEXT(c)))) : 0)
#endif

#ifdef F_LEAPS_ALWAYS   /* a turn left out at each take-over, and by `begun` as well */
#define ALWAYS(taken, c) (taken -> TURN(c) : c)
#else
#define ALWAYS(taken, c) c
#endif

#define AT_WORK(p) (busy[p] && !stalled[p] && !dead[p])
#define GO(p) (!stalled[p] && !dead[p] && (excl == 0 || excl == (p) + 1) && ROOM(p))
#define DO(p, c) atomic { GO(p) && (c) ->
#define COMPLETES(p) if :: mem[WRITER] != (p) + 1 -> late = 1 :: else fi
#define ALONE(p) zone[p] = 0; if :: excl == (p) + 1 -> excl = 0 :: else fi

proctype Fate()
{
    byte p;
    do
    :: atomic { stalls > 0 && excl == 0 ->
           if :: p = P :: p = L :: p = R fi;
           if
           :: AT_WORK(p) && (p == R || DRAINED(p)) -> stalls--; stalled[p] = 1; slept[p] = 1
           fi; p = 0 }
#ifdef WINDOW
    :: atomic { stalled[P] -> stalled[P] = 0 }
    :: atomic { stalled[L] -> stalled[L] = 0 }
#else
    :: atomic { stalled[P] && !(zone[P] && (zone[L] || !DRAINED(L))) -> stalled[P] = 0; if :: zone[P] -> excl = P + 1 :: else fi }
    :: atomic { stalled[L] && !(zone[L] && (zone[P] || !DRAINED(P))) -> stalled[L] = 0; if :: zone[L] -> excl = L + 1 :: else fi }
#endif
    :: atomic { stalled[R] -> stalled[R] = 0 }
    :: atomic { crashes > 0 && excl == 0 ->
           if :: p = P :: p = L :: p = R fi;
           if
           :: AT_WORK(p) && (p == R || DRAINED(p)) -> crashes--; dead[p] = 1
           fi; p = 0 }
    od
}

/* ---- the lock ---- */
#define SAME(h, c) (h == mem[HOLDER] && c == mem[COUNT])
#define ENTER(p) mem[COUNT]++; mem[HOLDER] = (p) + 1
#define LEAVE(p) mem[HOLDER] = 0; sem++

#include "plc.pml"
#include "python.pml"

/* When all is quiet. */
proctype Judge()
{
    byte newest;
    timeout -> atomic {
        newest = mem[COMPLETED];
        if
        :: newest != 0 && mem[NUMBER(newest)] == newest && DISTANCE(newest, mem[BEGUN]) < 2 ->
           assert(mem[HALF1(newest)] == mem[HALF2(newest)])
        :: else -> assert(newest == 0 || late)
        fi }
}

init {
    atomic {
        START_MEMORY;
#ifdef START_P   /* P has published a sample, and has been silent for long */
        mem[WRITER] = P + 1; mem[BEGUN] = NEWEST; mem[COMPLETED] = NEWEST; mem[BEAT] = 1;
        mem[NUMBER(NEWEST)] = NEWEST; mem[HALF1(NEWEST)] = 1; mem[HALF2(NEWEST)] = 1; tags = 1;
        p_sequence = NEWEST; p_beat = 1; p_tries = PUBLISHES;
        l_state = CLAIMING; l_seen = P + 1; l_beat = 1;
#endif
#ifdef START_L   /* the same of L */
        mem[WRITER] = L + 1; mem[BEGUN] = NEWEST; mem[COMPLETED] = NEWEST; mem[BEAT] = 1;
        mem[NUMBER(NEWEST)] = NEWEST; mem[HALF1(NEWEST)] = 1; mem[HALF2(NEWEST)] = 1; tags = 1;
        l_state = RUNNING; l_beat = 1; l_last = NEWEST;
#endif
        run Python(); run Plc(); run Reader(); run Fate(); run Judge()
    }
}
