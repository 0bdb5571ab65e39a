/* A sample written and read in an ARM-like order (WEAK): the slots of one lane, with the barriers that C, Python without
 * the extension, and ST without a lock have. Who writes in which lane is explored by tests/explorer.
 *
 * Stores pass each other in W's buffer. R's loads are made here in another order: the copy before the first look at the
 * number, or behind the second.
 */
#define COMPLETED 0
#define SLOT0 1   /* number, two halves of the payload; slot 1 after it */
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
       ST(W, COMPLETED, n)   /* that this may pass the number costs a reader one look more */
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
#ifdef COPY_FIRST   /* needs no barrier: what is complete was whole before */
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
