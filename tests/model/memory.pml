/* Shared memory, and the order in which stores reach it. The including file defines WORDS, the number of words, and ENDS,
 * the number of processes.
 *
 * LD is a load and ST a store of one process. By default, each store reaches the memory at once (sequential consistency).
 * TSO   Each process has a store buffer, first in, first out, and loads its own buffered stores, as on x86-64.
 * WEAK  Like TSO, but only stores to the same word keep their order, as on ARM. A model that needs reordered loads
 *       reorders them itself.
 * DRAINED waits for an empty buffer, as a full barrier and a locked instruction do.
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
