/* Making a region: two ends, in either order, at once, dying or standing still at any step.
 *
 * Whoever finds no magic writes the header, magic last, and looks at it once more later (a Python process after 2 ms, a
 * PLC in its next cycle). With one layout everybody gets in and finds the whole header; with two (DIFFERENT) never both,
 * unless somebody stood still between his look at the magic and his stores.
 */
#define P 0
#define Q 1
#define L 2
#define MAGIC  0
#define DIGEST 1
#define SLOTS  2
#define WORDS  3

#ifndef CRASHES
#define CRASHES 1
#endif
#ifndef STALLS
#define STALLS 0
#endif
#ifdef DIFFERENT
#define LAYOUT(p) (p == L -> 2 : 1)
#else
#define LAYOUT(p) 1
#endif

byte mem[WORDS];
byte crashes = CRASHES, stalls = STALLS;
bit dead[3], stalled[3], busy[3], wrote[3], slow, repair, finished[3];
byte opened[3];   /* with which layout */

#if defined(TSO) || defined(WEAK)
chan buffer[3] = [4] of { byte, byte };
byte own[9], pending[9];
#define LD(p, a) (pending[(p) * WORDS + (a)] -> own[(p) * WORDS + (a)] : mem[a])
#define ST(p, a, v) own[(p) * WORDS + (a)] = v; pending[(p) * WORDS + (a)]++; buffer[p]!a,own[(p) * WORDS + (a)]
#define DRAINED(p) (len(buffer[p]) == 0)
#define DRAIN(a) mem[a] = v; pending[p * WORDS + a]--; own[p * WORDS + a] = 0; v = 0
proctype Drain(byte p)
{
    byte a, v;
end:
    do
#ifdef WEAK
    :: atomic { buffer[p]??MAGIC,v -> DRAIN(MAGIC) }
    :: atomic { buffer[p]??DIGEST,v -> DRAIN(DIGEST) }
    :: atomic { buffer[p]??SLOTS,v -> DRAIN(SLOTS) }
#else
    :: atomic { buffer[p]?a,v -> DRAIN(a); a = 0 }
#endif
    od
}
#else
#define LD(p, a) mem[a]
#define ST(p, a, v) mem[a] = v
#define DRAINED(p) true
#endif

#define AT_WORK(p) (busy[p] && !dead[p] && !stalled[p])
#define DO(p, c) atomic { !dead[p] && !stalled[p] && (c) ->
/* So much time passes that whoever is at work is through with his stores. */
#define LATER(p) (DRAINED(P) && DRAINED(Q) && DRAINED(L) && (p == P || !AT_WORK(P)) && (p == Q || !AT_WORK(Q)) && (p == L || !AT_WORK(L)))

proctype Fate()
{
    byte p;
    do
    :: atomic { crashes > 0 -> if :: p = P :: p = Q :: p = L fi;
           if :: AT_WORK(p) -> crashes--; dead[p] = 1; repair = (p == L -> repair : 0) fi; p = 0 }
    :: atomic { stalls > 0 -> if :: p = P :: p = Q :: p = L fi;
           if :: AT_WORK(p) && DRAINED(p) -> stalls--; stalled[p] = 1; slow = 1 fi; p = 0 }
    :: atomic { stalled[P] -> stalled[P] = 0 }
    :: atomic { stalled[Q] -> stalled[Q] = 0 }
    :: atomic { stalled[L] -> stalled[L] = 0 }
    od
}

inline look(p) {
    if
    :: DO(p, LD(p, MAGIC) == 0) skip }
       wrote[p] = 1;
#ifdef F_MAGIC_FIRST
       DO(p, true) ST(p, MAGIC, 1) }
       DO(p, true) ST(p, DIGEST, LAYOUT(p)) }
       DO(p, true) ST(p, SLOTS, LAYOUT(p)) }
#else
       DO(p, true) ST(p, DIGEST, LAYOUT(p)) }
       DO(p, true) ST(p, SLOTS, LAYOUT(p)) }
       DO(p, true) ST(p, MAGIC, 1) }
#endif
    :: DO(p, LD(p, MAGIC) != 0) skip }
    fi
}

inline compare(p) {
    if
    :: DO(p, LD(p, DIGEST) != LAYOUT(p)) goto mismatch }
    :: DO(p, LD(p, DIGEST) == LAYOUT(p)) skip }
    fi;
    if
    :: DO(p, LD(p, SLOTS) != LAYOUT(p)) goto mismatch }
    :: DO(p, LD(p, SLOTS) == LAYOUT(p)) skip }
    fi
}

proctype Python(byte p)
{
    DO(p, true) busy[p] = 1 }
    if   /* the record lock, waited for a while; who died gives it back */
    :: DO(p, !repair) repair = 1 }
       look(p);
       DO(p, true) repair = 0 }
    :: DO(p, repair && LATER(p)) skip }
       look(p)
    fi;
    compare(p);
#ifndef F_NO_SECOND_LOOK
    if
    :: DO(p, wrote[p]) busy[p] = 0 }
       DO(p, LATER(p)) busy[p] = 1 }
       compare(p)
    :: DO(p, !wrote[p]) skip }
    fi;
#endif
    DO(p, true) opened[p] = LAYOUT(p); goto over }
mismatch:
    DO(p, true) opened[p] = 9 }
over:
    DO(p, true) busy[p] = 0; finished[p] = 1 }
}

proctype Plc()
{
    DO(L, true) busy[L] = 1 }
    look(L);
    compare(L);
#ifndef F_NO_SECOND_LOOK
    DO(L, true) busy[L] = 0 }
    DO(L, LATER(L)) busy[L] = 1 }
    compare(L);
#endif
    DO(L, true) opened[L] = LAYOUT(L); goto over }
mismatch:
    DO(L, true) opened[L] = 9 }
over:
    DO(L, true) busy[L] = 0; finished[L] = 1 }
}

proctype Judge()
{
    timeout ->
#ifdef DIFFERENT
    assert(slow || !((opened[P] == 1 || opened[Q] == 1) && opened[L] == 2))
#else
    assert(opened[P] != 9 && opened[Q] != 9 && opened[L] != 9);
    assert(!(finished[P] || finished[Q] || finished[L]) || mem[MAGIC] == 1)
#endif
}

init {
    atomic {
#if defined(TSO) || defined(WEAK)
        run Drain(P); run Drain(Q); run Drain(L);
#endif
        run Python(P); run Plc(); run Fate(); run Judge();
#ifdef THREE
        run Python(Q)
#endif
    }
}
