/* Shared words, and in which order what is stored reaches them. Whoever includes this has defined WORDS, how many there
 * are, and ENDS, how many processes.
 *
 * LD and ST are one load and one store of an end. At once (sequential consistency) unless told otherwise:
 * TSO   each end has a buffer, first in, first out, and sees its own stores in it, as on x86-64;
 * WEAK  what leaves a buffer keeps its order for each word only: ARM, from the side of who stores. What loads may do out
 *       of order is said where it matters.
 * A locked instruction, a release of the lock, and time let a buffer run dry: DRAINED.
 */
byte mem[WORDS];

/* FENCES: both ends have full barriers, those of templates/c, of runtime/region/memory_order.py, and Fence in FB_ShmRegion.st. */
#if defined(FENCES) && !defined(F_NO_FENCE_P)
#define FENCE_P DO(P, DRAINED(P)) skip }
#else
#define FENCE_P
#endif
#if defined(FENCES) && !defined(F_NO_FENCE_L)
#define FENCE_L DO(L, DRAINED(L)) skip }
#else
#define FENCE_L
#endif
#if defined(WEAK) && (!defined(FENCES) || defined(F_NO_FENCE_R))
#define LOADS_PASS
#endif

#if defined(TSO) || defined(WEAK)
#define DEPTH 8
chan buffer[ENDS] = [DEPTH] of { byte, byte };
byte own[ENDS * WORDS], pending[ENDS * WORDS];

#define AT(p, a) ((p) * WORDS + (a))
#define LD(p, a) (pending[AT(p, a)] -> own[AT(p, a)] : mem[a])
#define ST(p, a, v) own[AT(p, a)] = v; pending[AT(p, a)]++; buffer[p]!a,own[AT(p, a)]
#define ROOM(p) (len(buffer[p]) < DEPTH - 4)
#define DRAINED(p) (len(buffer[p]) == 0)

/* BEGUN and COMPLETED in one store of eight bytes; stores to one word keep their order, so it waits for its halves. */
#ifdef PAIR
#define ST_PAIR(p, v) ST(p, PAIR, v)
#define WAITS(p, a) (a == PAIR && pending[AT(p, BEGUN)] + pending[AT(p, COMPLETED)] > 0)
#define REACHES(a, v) if :: a == PAIR -> mem[BEGUN] = v; mem[COMPLETED] = v :: else -> mem[a] = v fi
#else
#define WAITS(p, a) false
#define REACHES(a, v) mem[a] = v
#endif

#define LEAVES(p, a, v) \
    REACHES(a, v); pending[AT(p, a)]--; \
    if :: pending[AT(p, a)] == 0 -> own[AT(p, a)] = 0 :: else fi

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
           :: pending[AT(p, a)] > 0 && !WAITS(p, a) -> buffer[p]??eval(a),v; LEAVES(p, a, v)
           :: else
           fi;
           a = 0; v = 0 }
#else
    :: atomic { buffer[p]?a,v -> LEAVES(p, a, v); a = 0; v = 0 }
#endif
    od
}
#define START_MEMORY a_ = 0; do :: a_ < ENDS -> run Drain(a_); a_++ :: else -> break od; a_ = 0
byte a_;
#else
#define LD(p, a) (mem[a])
#define ST(p, a, v) mem[a] = v
#define ST_PAIR(p, v) mem[BEGUN] = v; mem[COMPLETED] = v
#define ROOM(p) true
#define DRAINED(p) true
#define START_MEMORY skip
#endif
