/* Writing and reading samples in one lane without the lock, with the barriers of C, of Python without the extension, and of
 * Structured Text. With WEAK, memory accesses may be reordered, as on ARM. tests/explorer covers the choice of the lane.
 *
 * The writer's stores overtake each other in its buffer. The reader's loads are reordered explicitly: the copy comes before
 * the first load of the slot's number (COPY_FIRST) or after the second load (F_COPY_LAST).
 */
#define COMPLETED 0
#define SLOT0 1   /* the slot's number and two halves of its payload; slot 1 follows */
#define WORDS 7
#define NUMBER(n) (SLOT0 + 3 * ((n) % 2))
#define ENDS 1
#define W 0
#include "memory.pml"

#ifndef SAMPLES
#define SAMPLES 4
#endif
#ifndef READS
#define READS 2
#endif

byte n, newest, first, second, half1, half2, reads;

proctype Writer()
{
    do
    :: n < SAMPLES ->
       n++;
       ST(W, NUMBER(n), 0);
#ifndef F_NO_FENCE_BEFORE
       DRAINED(W);
#endif
       ST(W, NUMBER(n) + 1, n);
       ST(W, NUMBER(n) + 2, n);
#ifndef F_NO_FENCE_BEHIND
       DRAINED(W);
#endif
       ST(W, NUMBER(n), n);
       ST(W, COMPLETED, n)   /* may overtake the number; the reader then only retries */
    :: else -> break
    od
}

#define COPY half1 = mem[NUMBER(newest) + 1]; half2 = mem[NUMBER(newest) + 2]

proctype Reader()
{
    do
    :: reads < READS ->
       reads++; newest = mem[COMPLETED];
       if
       :: newest == 0
       :: newest != 0 ->
          if
#ifdef COPY_FIRST   /* needs no barrier: the sample was complete before the copy */
          :: COPY; first = mem[NUMBER(newest)]; second = mem[NUMBER(newest)]
#endif
#ifdef F_COPY_LAST
          :: first = mem[NUMBER(newest)]; second = mem[NUMBER(newest)]; COPY
#endif
          :: first = mem[NUMBER(newest)]; COPY; second = mem[NUMBER(newest)]
          fi;
          atomic {
              if
              :: first == newest && second == newest -> assert(half1 == newest && half2 == newest)
              :: else
              fi;
              newest = 0; first = 0; second = 0; half1 = 0; half2 = 0 }
       fi
    :: else -> break
    od
}

proctype Judge()
{
    timeout -> assert(mem[COMPLETED] == SAMPLES && mem[NUMBER(SAMPLES)] == SAMPLES)
}

init { atomic { START_MEMORY; run Writer(); run Reader(); run Judge() } }
