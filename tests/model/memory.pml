/* Shared words, and the order in which stores reach them.
 *
 * LD and ST are single loads and stores. SC: at once. TSO: each process has a buffer, first in first out, and sees its
 * own stores in it (x86-64). WEAK: as TSO, but what leaves a buffer is in order for each word only (an approximation of
 * ARM from the writers' side; what loads may do out of order is in the reader).
 */
#define WRITER    0
#define BEGUN     1
#define COMPLETED 2
#define BEAT      3
#define HOLDER    4
#define COUNT     5
#define RECOV     6
#define SLOT0     7  /* number, two halves of the payload; slot 1 after it */
#define PAIR      13 /* BEGUN and COMPLETED in one store of eight bytes */
#define WORDS     14
#define NUMBER(n)  (SLOT0 + 3 * ((n) % 2))
#define HALF1(n)   (NUMBER(n) + 1)
#define HALF2(n)   (NUMBER(n) + 2)

#define P 0
#define L 1
#define R 2

byte mem[WORDS];

#if defined(TSO) || defined(WEAK)
#define DEPTH 8
chan buffer[3] = [DEPTH] of { byte, byte };
byte own[42], pending[42];

#define LD(p, a) (pending[(p) * WORDS + (a)] -> own[(p) * WORDS + (a)] : mem[a])
#define ST(p, a, v) own[(p) * WORDS + (a)] = v; pending[(p) * WORDS + (a)]++; buffer[p]!a,own[(p) * WORDS + (a)]
#define ST_PAIR(p, v) ST(p, PAIR, v)
#define ROOM(p) (len(buffer[p]) < DEPTH - 4)
#define DRAINED(p) (len(buffer[p]) == 0)

proctype Drain(byte p)
{
    byte a, v;
end:
    do
    :: atomic {
           buffer[p]?a,v ->
           if
           :: a == PAIR -> mem[BEGUN] = v; mem[COMPLETED] = v
           :: else -> mem[a] = v
           fi;
           pending[p * WORDS + a]--;
           if
           :: pending[p * WORDS + a] == 0 -> own[p * WORDS + a] = 0
           :: else
           fi;
           a = 0; v = 0
       }
    od
}
#define START_MEMORY run Drain(P); run Drain(L)
#else
#define LD(p, a) (mem[a])
#define ST(p, a, v) mem[a] = v
#define ST_PAIR(p, v) mem[BEGUN] = v; mem[COMPLETED] = v
#define ROOM(p) true
#define DRAINED(p) true
#define START_MEMORY skip
#endif
