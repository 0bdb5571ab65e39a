/* One region: a Python process P and a PLC L that both want to write it, and a reader R in Python.
 *
 * Slots, lock, healing, claim and the change of writers, loads and stores one by one; what the lock keeps in its words
 * is one step with its semaphore here (lock.pml has them one by one). Each end may stand still for a second or more
 * (STALLS) or die (CRASHES) at any step.
 *
 * Time: a second passes only while nobody who runs is at work, because a write or a read takes far less; the same for
 * the tenth of a second in which a name must stand.
 */
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

/* What must be left out so that no number is used twice: the writer before may have filled the slot, and may still
 * complete it. */
#ifdef F_NO_LEAP
#define LEAP(p, c) 0
#else
#define LEAP(p, c) (LD(p, NUMBER((c) + 1)) > (c) -> LD(p, NUMBER((c) + 1)) + 2 - ((c) + 1) : 0)
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
           :: AT_WORK(p) -> crashes--; dead[p] = 1; zone[p] = 0
           fi; p = 0 }
    od
}

/* ---- the lock ---- */
#define SAME(h, c) (h == mem[HOLDER] && c == mem[COUNT])
#define ENTER(p) mem[COUNT]++; mem[HOLDER] = (p) + 1
#define LEAVE(p) mem[HOLDER] = 0; sem++

/* ---- what both have ---- */
#define OPENING  0
#define CLAIMING 1
#define CLAIMED  2
#define RUNNING  3
byte l_state, l_seen, l_beat, l_number, l_last, l_tag, l_cycles = CYCLES, l_closes = CLOSES;
byte l_holder, l_count, l_jump;
bit l_aged, l_missed, l_heal, l_got;

/* ---- Python: Publisher ---- */
byte p_holder, p_count, p_sequence, p_jump, p_beat, p_number, p_tries, p_tag, p_seen;
bit p_noted, p_aged, p_inside;

/* acquire(False) or self._wait(): a wait that ends well is a try made later. */
inline p_acquire() {
    if
#ifdef NOLOCK
    :: DO(P, true) p_inside = 0 }
#else
    :: DO(P, DRAINED(P) && sem > 0) sem--; p_inside = 1; ENTER(P); p_noted = 0; p_aged = 0; p_holder = 0; p_count = 0 }
    :: DO(P, sem == 0 && p_aged && SAME(p_holder, p_count) && DRAINED(P))
           /* _take_over */
           p_inside = 1; ENTER(P); mem[RECOV] = 1; p_noted = 0; p_aged = 0; p_holder = 0; p_count = 0 }
    :: DO(P, sem == 0 && !(p_aged && SAME(p_holder, p_count)))
           p_inside = 0; p_aged = 0; p_noted = 1; p_holder = mem[HOLDER]; p_count = mem[COUNT] }
#endif
    fi
}

inline p_release() {
    DO(P, DRAINED(P))
        if
        :: p_inside -> LEAVE(P); if :: mem[RECOV] && sem > 1 -> sem = 1 :: else fi   /* take_surplus */
        :: else
        fi;
        p_inside = 0; p_number = 0; p_tag = 0; busy[P] = 0 }
}

proctype Python()
{
    byte opens = OPENS;
#ifdef START_P
    goto opened;
#endif
open:
    if
    :: DO(P, opens > 0) opens--; busy[P] = 1; slept[P] = 0; p_tries = PUBLISHES;
           p_seen = LD(P, WRITER); p_beat = LD(P, BEAT); cycled = 0 }
    :: DO(P, opens == 0) goto over }
    fi;
    if
    :: DO(P, p_seen == L + 1) busy[P] = 0 }
       /* A second of watching, in which a PLC that runs makes a cycle. */
       DO(P, !AT_WORK(L) && !AT_WORK(R)
#ifndef F_SHORT_WATCH
          && (cycled || stalled[L] || dead[L] || ended[L])
#endif
          ) busy[P] = 1 }
       if
       :: DO(P, LD(P, BEAT) != p_beat || LD(P, WRITER) != p_seen) busy[P] = 0; goto open }
       :: DO(P, LD(P, BEAT) == p_beat && LD(P, WRITER) == p_seen) skip }
       fi;
       DO(P, true) assert(stalls < STALLS || ended[L] || dead[L] || l_state != RUNNING); ST(P, WRITER, P + 1) }
    :: DO(P, p_seen != L + 1) ST(P, WRITER, P + 1) }
    fi;
#ifndef F_NO_CONFIRM
    if
    :: DO(P, p_seen == L + 1 || slept[P]) skip }
       DO(P, DRAINED(P)) busy[P] = 0 }
       DO(P, !AT_WORK(L)) busy[P] = 1 }
       if
       :: DO(P, LD(P, WRITER) != P + 1) busy[P] = 0; goto open }
       :: DO(P, LD(P, WRITER) == P + 1) skip }
       fi
    :: DO(P, p_seen != L + 1 && !slept[P]) skip }
    fi;
#endif
    DO(P, DRAINED(P)) 
        p_sequence = LD(P, COMPLETED); p_jump = LEAP(P, p_sequence); p_beat = LD(P, BEAT); busy[P] = 0; p_seen = 0 }
opened:
    do
    :: DO(P, p_tries > 0) p_tries--; busy[P] = 1; slept[P] = 0; p_number = p_sequence + 1 }
       p_acquire();
#ifndef F_NO_LOOK
       if
       :: DO(P, LD(P, WRITER) != P + 1) p_tries = 0; goto release }
       :: DO(P, LD(P, WRITER) == P + 1) zone[P] = 1 }
       fi;
#else
       DO(P, true) zone[P] = 1 }
#endif
       DO(P, true) ST(P, BEAT, p_beat + 1); p_beat++ }
#ifndef F_NUMBER_NOT_FIRST
       if
       :: DO(P, p_jump) ST(P, NUMBER(p_number), p_number + p_jump) }
       :: DO(P, !p_jump) skip }
       fi;
#endif
       DO(P, true)
           assert(!zone[L] || slept[P] || slept[L]);
           if :: mem[WRITER] != P + 1 -> late = 1 :: else fi;
#ifdef F_BEGUN_LEAPS
           p_number = p_number + p_jump; ST(P, BEGUN, p_number);
#else
           ST(P, BEGUN, p_number); p_number = p_number + p_jump;
#endif
           tags++; p_tag = tags }
       if   /* memcpy promises no order */
       :: DO(P, true) ST(P, NUMBER(p_number), p_number) }
          DO(P, true) ST(P, HALF1(p_number), p_tag) }
          DO(P, true) ST(P, HALF2(p_number), p_tag) }
       :: DO(P, true) ST(P, HALF1(p_number), p_tag) }
          DO(P, true) ST(P, HALF2(p_number), p_tag) }
          DO(P, true) ST(P, NUMBER(p_number), p_number) }
       fi;
       if
#ifndef F_NO_VOID
       :: DO(P, LD(P, WRITER) != P + 1) ST(P, NUMBER(p_number), 0); p_tries = 0; late = 1; goto voided }
       :: DO(P, LD(P, WRITER) == P + 1) ALONE(P) }
#else
       :: DO(P, true) ALONE(P) }
#endif
       fi;
       if
       :: DO(P, !p_jump) ST(P, COMPLETED, p_number); COMPLETES(P); p_sequence = p_number; goto release }
       :: DO(P, p_jump) ST_PAIR(P, p_number); COMPLETES(P); p_sequence = p_number; p_jump = 0; goto release }
       fi;
voided:
       DO(P, DRAINED(P)) ALONE(P) }
release:
       p_release()
    :: DO(P, p_noted && !p_aged && !AT_WORK(L) && !AT_WORK(R)) p_aged = 1 }
    :: DO(P, p_tries == 0) p_sequence = 0; p_jump = 0; p_beat = 0; p_noted = 0; p_aged = 0; p_holder = 0; p_count = 0; goto open }
    od;
over:
    ended[P] = 1
}

/* ---- the PLC: FB_ShmRegion, one Cycle and perhaps one write at a time ---- */
inline l_lock() {
    if
#ifdef NOLOCK
    :: DO(L, true) l_got = 1 }
#else
    :: DO(L, DRAINED(L) && sem > 0) sem--; l_got = 1; ENTER(L); l_missed = 0; l_heal = 0; l_holder = 0; l_count = 0;
           if :: mem[RECOV] && sem > 0 -> sem-- :: else fi }
    :: DO(L, sem == 0 && l_heal && SAME(l_holder, l_count) && DRAINED(L))
           l_got = 0; l_missed = 0; l_heal = 0; l_holder = 0; l_count = 0; mem[RECOV] = 1 }
       DO(L, true) LEAVE(L) }
    :: DO(L, sem == 0 && !(l_heal && SAME(l_holder, l_count)))
           l_got = 0; l_missed = 1; l_heal = 0; l_holder = mem[HOLDER]; l_count = mem[COUNT] }
#endif
    fi
}

inline l_unlock() {
#ifndef NOLOCK
    DO(L, DRAINED(L)) LEAVE(L); l_got = 0; busy[L] = 0; l_number = 0; l_tag = 0 }
#else
    DO(L, DRAINED(L)) l_got = 0; busy[L] = 0; l_number = 0; l_tag = 0 }
#endif
}

#define GIVE_WAY l_jump = 0; l_beat = LD(L, BEAT); l_seen = LD(L, WRITER); l_aged = 0; l_state = CLAIMING
#ifdef F_BEAT_ONLY   /* today CLAIMING looks at the heartbeat only */
#define QUIET (LD(L, BEAT) == l_beat)
#else
#define QUIET (LD(L, BEAT) == l_beat && LD(L, WRITER) == l_seen)
#endif
#define REST DO(L, DRAINED(L)) busy[L] = 0 }

inline l_write() {
#ifdef F_NUMBER_FROM_COMPLETED
    DO(L, true) l_number = LD(L, COMPLETED) + 1;
#else
    DO(L, true) l_number = l_last + 1;
#endif
        assert(!zone[P] || slept[P] || slept[L]);
        if :: mem[WRITER] != L + 1 -> late = 1 :: else fi;
#ifdef F_BEGUN_LEAPS
        l_number = l_number + l_jump; ST(L, BEGUN, l_number);
#else
        ST(L, BEGUN, l_number); l_number = l_number + l_jump;
#endif
        tags++; l_tag = tags }
    DO(L, true) ST(L, NUMBER(l_number), l_number) }
    DO(L, true) ST(L, HALF1(l_number), l_tag) }
    DO(L, true) ST(L, HALF2(l_number), l_tag) }
    if
#ifndef F_NO_VOID
    :: DO(L, LD(L, WRITER) != L + 1) ST(L, NUMBER(l_number), 0); late = 1; GIVE_WAY }
       DO(L, DRAINED(L)) ALONE(L); goto done }
    :: DO(L, LD(L, WRITER) == L + 1) ALONE(L) }
#else
    :: DO(L, true) ALONE(L) }
#endif
    fi;
    if
    :: DO(L, !l_jump) ST(L, COMPLETED, l_number); COMPLETES(L); l_last = l_number }
#ifdef F_PAIR_APART   /* a PLC of 32 bits */
    :: DO(L, l_jump) ST(L, BEGUN, l_number) }
       DO(L, true) ST(L, COMPLETED, l_number); COMPLETES(L); l_last = l_number; l_jump = 0 }
#else
    :: DO(L, l_jump) ST_PAIR(L, l_number); COMPLETES(L); l_last = l_number; l_jump = 0 }
#endif
    fi;
done:
    skip
}

proctype Plc()
{
    do
    :: DO(L, l_cycles > 0) busy[L] = 1; slept[L] = 0; l_cycles--; cycled = 1 }
       if
       :: DO(L, l_state == OPENING) l_beat = LD(L, BEAT); l_seen = LD(L, WRITER); l_state = CLAIMING;
              l_aged = (l_seen == 0) }
          REST
       :: DO(L, l_state >= CLAIMING && l_state <= CLAIMED && !QUIET) GIVE_WAY }
          REST
       :: DO(L, l_state == CLAIMING && QUIET && l_aged) skip }
          DO(L, true) ST(L, WRITER, L + 1); l_state = CLAIMED; l_aged = 0; l_seen = L + 1 }
          REST
       :: DO(L, l_state == CLAIMED && QUIET && l_aged) l_last = LD(L, COMPLETED); l_jump = LEAP(L, l_last); l_seen = 0; l_state = RUNNING;
              l_aged = 0; l_beat++; ST(L, BEAT, l_beat) }
          REST
       :: DO(L, l_state >= CLAIMING && l_state <= CLAIMED && QUIET && !l_aged) skip }
          l_lock();   /* Probe */
          if
          :: DO(L, l_got) skip }
             l_unlock()
          :: DO(L, !l_got) busy[L] = 0 }
          fi
       :: DO(L, l_state == RUNNING && (LD(L, WRITER) != L + 1 || LD(L, BEAT) != l_beat)) GIVE_WAY }
          REST
       :: DO(L, l_state == RUNNING && LD(L, WRITER) == L + 1 && LD(L, BEAT) == l_beat) l_beat++; ST(L, BEAT, l_beat) }
          if
          :: REST   /* nothing to send in this cycle */
          :: l_lock();
             if
             :: DO(L, !l_got) skip }
                REST
             :: DO(L, l_got) skip }
                if
#ifndef F_NO_LOOK
                :: DO(L, LD(L, WRITER) != L + 1) GIVE_WAY }
                :: DO(L, LD(L, WRITER) == L + 1) zone[L] = 1 }
                   l_write()
#else
                :: DO(L, true) zone[L] = 1 }
                   l_write()
#endif
                fi;
                l_unlock()
             fi
          fi
       fi
    :: DO(L, !busy[L] && (l_state == CLAIMING || l_state == CLAIMED) && !l_aged && !AT_WORK(P) && !AT_WORK(R)) l_aged = 1 }
#ifdef F_NO_CONFIRM
    :: DO(L, !busy[L] && l_state == CLAIMED && !l_aged) l_aged = 1 }
#endif
    :: DO(L, !busy[L] && l_missed && !l_heal && !AT_WORK(P) && !AT_WORK(R)) l_heal = 1 }
    :: DO(L, !busy[L] && l_closes > 0 && l_state != OPENING) l_closes--; busy[L] = 1; slept[L] = 0 }
       if
#ifdef F_CLOSE_ANY
       :: DO(L, l_state >= CLAIMED) assert(mem[WRITER] == L + 1 || slept[L]); ST(L, WRITER, 0) }
#else
       :: DO(L, l_state == RUNNING && LD(L, WRITER) == L + 1) skip }
          DO(L, true) assert(mem[WRITER] == L + 1 || slept[L]); ST(L, WRITER, 0) }
       :: DO(L, l_state == CLAIMED || l_state == RUNNING && !(LD(L, WRITER) == L + 1)) skip }
#endif
       :: DO(L, l_state < CLAIMED) skip }
       fi;
       DO(L, DRAINED(L)) l_state = OPENING; l_jump = 0; l_aged = 0; busy[L] = 0; l_missed = 0; l_heal = 0; l_seen = 0; l_beat = 0 }
    :: DO(L, l_cycles == 0 && !busy[L]) ended[L] = 1; break }
    od
}

/* ---- a reader in Python: Subscriber._copy ---- */
byte r_number, r_found, r_one, r_two, r_last, r_reads = READS;
bit r_inside, r_whole;

#define DISTANCE(s, b) ((b) >= (s) -> (b) - (s) : 255)

proctype Reader()
{
    do
    :: DO(R, r_reads > 0 && mem[COMPLETED] != r_last && mem[COMPLETED] != 0)
           busy[R] = 1; r_reads--; r_number = mem[COMPLETED] }
       if
#ifdef NOLOCK
       :: DO(R, true) r_inside = 0 }
#else
       :: DO(R, sem > 0) sem--; r_inside = 1; ENTER(R) }
       :: DO(R, sem == 0) r_inside = 0 }
#endif
       fi;
#ifdef F_NUMBER_BEFORE_COPY
       DO(R, true) r_found = mem[NUMBER(r_number)] }
#endif
       DO(R, true) r_one = mem[HALF1(r_number)] }
       DO(R, true) r_two = mem[HALF2(r_number)] }
#ifdef F_NUMBER_BEFORE_BEGUN
       DO(R, true) r_found = mem[NUMBER(r_number)] }
#endif
       DO(R, true) r_whole = DISTANCE(r_number, mem[BEGUN]) < 2 }
#if !defined(F_NUMBER_BEFORE_BEGUN) && !defined(F_NUMBER_BEFORE_COPY)
       DO(R, true) r_found = mem[NUMBER(r_number)];
#else
       DO(R, true)
#endif
           if
           :: r_whole && r_found == r_number -> assert(r_one == r_two && r_one != 0); r_last = r_number
           :: else
           fi;
           if
           :: r_inside -> LEAVE(R); r_inside = 0; if :: mem[RECOV] && sem > 1 -> sem = 1 :: else fi
           :: else
           fi;
           busy[R] = 0; r_number = 0; r_whole = 0; r_found = 0; r_one = 0; r_two = 0 }
    :: DO(R, r_reads == 0) ended[R] = 1; break }
    od
}

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
#ifdef START_P   /* P has published sample 1, and has been silent for long */
        mem[WRITER] = P + 1; mem[BEGUN] = 1; mem[COMPLETED] = 1; mem[BEAT] = 1;
        mem[NUMBER(1)] = 1; mem[HALF1(1)] = 1; mem[HALF2(1)] = 1; tags = 1;
        p_sequence = 1; p_beat = 1; p_tries = PUBLISHES;
        l_state = CLAIMING; l_seen = P + 1; l_beat = 1;
#endif
#ifdef START_L   /* the same of L */
        mem[WRITER] = L + 1; mem[BEGUN] = 1; mem[COMPLETED] = 1; mem[BEAT] = 1;
        mem[NUMBER(1)] = 1; mem[HALF1(1)] = 1; mem[HALF2(1)] = 1; tags = 1;
        l_state = RUNNING; l_beat = 1; l_last = 1;
#endif
        run Python(); run Plc(); run Reader(); run Fate(); run Judge()
    }
}
