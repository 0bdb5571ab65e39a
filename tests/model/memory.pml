/* Shared words, and in which order what is stored reaches them. Whoever includes this has defined WORDS, how many there
 * are, and ENDS, how many processes.
 *
 * LD and ST are one load and one store of an end. At once (sequential consistency) unless told otherwise:
 * TSO   each end has a buffer, first in, first out, and sees its own stores in it, as on x86-64;
 * WEAK  what leaves a buffer keeps its order for each word only: ARM, from the side of who stores. What loads may do out
 *       of order is said where it matters.
 * A full barrier, a locked instruction, and time let a buffer run dry: DRAINED.
 */
byte mem[WORDS];

#if defined(TSO) || defined(WEAK)
#define DEPTH 8
chan buffer[ENDS] = [DEPTH] of { byte, byte };
byte own[ENDS * WORDS], pending[ENDS * WORDS];

#define AT(p, a) ((p) * WORDS + (a))
#define LD(p, a) (pending[AT(p, a)] -> own[AT(p, a)] : mem[a])
#define ST(p, a, v) own[AT(p, a)] = v; pending[AT(p, a)]++; buffer[p]!a,own[AT(p, a)]
#define DRAINED(p) (len(buffer[p]) == 0)

proctype Drain(byte p)
{
    byte a, v;
end:
    do
#ifdef WEAK
    :: atomic {
           len(buffer[p]) > 0 ->
           select(a : 0 .. WORDS - 1);
           if
           :: pending[AT(p, a)] > 0 -> buffer[p]??eval(a),v; mem[a] = v; pending[AT(p, a)]--;
                  if :: pending[AT(p, a)] == 0 -> own[AT(p, a)] = 0 :: else fi
           :: else
           fi;
           a = 0; v = 0 }
#else
    :: atomic { buffer[p]?a,v -> mem[a] = v; pending[AT(p, a)]--;
           if :: pending[AT(p, a)] == 0 -> own[AT(p, a)] = 0 :: else fi;
           a = 0; v = 0 }
#endif
    od
}
#define START_MEMORY a_ = 0; do :: a_ < ENDS -> run Drain(a_); a_++ :: else -> break od; a_ = 0
byte a_;
#else
#define LD(p, a) (mem[a])
#define ST(p, a, v) mem[a] = v
#define DRAINED(p) true
#define START_MEMORY skip
#endif
