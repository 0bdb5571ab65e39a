/* The wake-up of waiting readers by the header fields `armed` and `bell`: a writer W and two readers R and S. With WEAK,
 * stores may overtake other stores, as on ARM.
 *
 * A wake-up is lost if a reader still sleeps after the writer has finished, although there is an unread sample. Such a sleep
 * ends after 10 ms in practice, but never in this model. tests/explorer covers the order of x86 with the shipped code. */
#define COMPLETED 0
#define ARMED 1
#define BELL 2
#define WORDS 3
#define W 0
#define R 1
#define S 2
#define ENDS 3
#include "memory.pml"

#ifndef SAMPLES
#define SAMPLES 2
#endif

byte last[ENDS], newest[ENDS], bell[ENDS];
bit asleep[ENDS], finished;

proctype Writer()
{
    byte number;
    do
    :: number < SAMPLES ->
       number++;
       ST(W, COMPLETED, number);
#ifndef F_NO_FENCE_WRITER   /* a PLC on 64-bit ARM has only the lock's release, which is not a full barrier */
       DRAINED(W);
#endif
       if
       :: LD(W, ARMED) ->
#ifdef F_BELL_FIRST
          ST(W, BELL, number); DRAINED(W); ST(W, ARMED, 0);
#else
          ST(W, ARMED, 0);
#ifndef F_UNORDERED
          DRAINED(W);   /* a release store writes `bell` */
#endif
          ST(W, BELL, number);
#endif
          atomic { DRAINED(W) -> asleep[R] = 0; asleep[S] = 0 }   /* the system call that wakes readers is a full barrier */
       :: !LD(W, ARMED)
       fi
    :: number == SAMPLES && DRAINED(W) -> finished = 1; break
    od
}

proctype Reader(byte p)
{
    do
    :: newest[p] = mem[COMPLETED];
       if
       :: newest[p] == SAMPLES -> break
       :: newest[p] != SAMPLES && newest[p] != last[p] -> last[p] = newest[p]
       :: newest[p] != SAMPLES && newest[p] == last[p] ->
#ifndef F_BELL_LATE
          bell[p] = mem[BELL];
#endif
#ifndef F_NOT_ARMED
          ST(p, ARMED, 1);
#endif
#ifndef F_NO_FENCE_READER
          DRAINED(p);
#endif
#ifdef F_BELL_LATE
          bell[p] = mem[BELL];
#endif
          if
#ifndef F_NO_SECOND_LOOK
          :: mem[COMPLETED] != last[p]
          :: mem[COMPLETED] == last[p] ->
#else
          :: true ->
#endif
             if
             :: atomic { DRAINED(p) && mem[BELL] == bell[p] -> asleep[p] = 1 }
                !asleep[p]
             :: DRAINED(p) && mem[BELL] != bell[p]
             fi
          fi
       fi
    od
}

proctype Judge()
{
    timeout -> assert(!asleep[R] && !asleep[S])
}

init { atomic { START_MEMORY; run Writer(); run Reader(R); run Reader(S); run Judge() } }
