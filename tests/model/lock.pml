/* The lock alone: two Python processes P and Q, a PLC L that may make the semaphore, step by step; healing, surplus.
 *
 * Everybody who tries again and again gets in, whoever dies or stands still inside (progress_python: `inside`), nobody is taken
 * for dead who is at work, and in the end there is one token.
 */
#define HOLDER_OF(p) ((p) + 1)
#define P 0
#define Q 1
#define L 2

#ifndef TRIES
#define TRIES 2
#endif
#ifdef FOREVER
#define COUNTS 3
#else
#define COUNTS 16
#endif
#ifndef STALLS
#define STALLS 1
#endif
#ifndef CRASHES
#define CRASHES 0
#endif

byte sem, holder, count, recoveries;
bit exists, repair;             /* the semaphore is there; the record lock that healers take */
byte stalls = STALLS, crashes = CRASHES, born;
bit busy[3], stalled[3], dead[3], inside[3], gap[3], ended[3], excused[3];  /* gap: between the semaphore and its words */
bit missed[3], aged[3], slow;   /* slow: somebody has stood still; excused: he, or he healed */
byte noted_holder[3], noted_count[3];
byte tries[3], completed;

#define AT_WORK(p) (busy[p] && !stalled[p] && !dead[p])
#define GO(p) (!stalled[p] && !dead[p])
#define DO(p, c) atomic { GO(p) && (c) ->
#define NOBODY_BUT(p) ((p == P || !AT_WORK(P)) && (p == Q || !AT_WORK(Q)) && (p == L || !AT_WORK(L)))
#define AT_FAULT(p, x) (p != x && inside[x] && AT_WORK(x) && !excused[x])
#if defined(MAKES) || defined(FOREVER) || CRASHES + STALLS > 1   /* two may be inside by right */
#ifdef FOREVER
#define EXTRA true
#else
#define EXTRA recoveries
#endif
#else
#define EXTRA false
#endif
#define WRONG(p) (!EXTRA && (AT_FAULT(p, P) || AT_FAULT(p, Q) || AT_FAULT(p, L)))
#define GAPS(p) ((p != P && gap[P] && AT_WORK(P)) || (p != Q && gap[Q] && AT_WORK(Q)) || (p != L && gap[L] && AT_WORK(L)))

#ifdef F_BY_COMPLETED   /* who goes on without the lock keeps `completed` moving */
#define SAME(p) (completed == noted_count[p])
#define NOTED completed
#else
#define NOTED count
#endif
#ifdef F_BY_COMPLETED
#elif defined(F_COUNT_ONLY)
#define SAME(p) (count == noted_count[p])
#else
#define SAME(p) (holder == noted_holder[p] && count == noted_count[p])
#endif
#define NOTE(p) missed[p] = 1; aged[p] = 0; noted_holder[p] = holder; noted_count[p] = NOTED
#define FORGET(p) missed[p] = 0; aged[p] = 0; noted_holder[p] = 0; noted_count[p] = 0
#define PID_IS_DEAD ((holder == HOLDER_OF(P) && dead[P]) || (holder == HOLDER_OF(Q) && dead[Q]))

#ifdef FOREVER   /* tries go on for ever, and a second passes when it can: see Makefile, progress */
#define MAY_TRY(p) (!(missed[p] && !aged[p] && CALM(p)))
#define COUNT_TRY(p) skip
#define CALM(p) (!(inside[P] && AT_WORK(P)) && !(inside[Q] && AT_WORK(Q)) && !(inside[L] && AT_WORK(L)))
#else
#define MAY_TRY(p) (tries[p] < TRIES)
#define COUNT_TRY(p) tries[p]++
#define CALM(p) NOBODY_BUT(p)
#endif

proctype Fate()
{
    byte p;
    do
    :: atomic { stalls > 0 ->
           if :: p = P :: p = Q :: p = L fi;
           if :: AT_WORK(p) -> stalls--; stalled[p] = 1; slow = 1; excused[p] = 1 fi; p = 0 }
    :: atomic { stalled[P] -> stalled[P] = 0 }
    :: atomic { stalled[Q] -> stalled[Q] = 0 }
    :: atomic { stalled[L] -> stalled[L] = 0 }
    :: atomic { crashes > 0 ->
           if :: p = P :: p = Q :: p = L fi;
           if :: AT_WORK(p) -> crashes--; dead[p] = 1; if :: p != L -> repair = 0 :: else fi fi; p = 0 }
    od
}

inline words_in(p) {
#ifdef F_HOLDER_FIRST
    DO(p, true) holder = HOLDER_OF(p) }
    DO(p, true) count = (count + 1) % COUNTS; gap[p] = 0 }
#else
    DO(p, true) count = (count + 1) % COUNTS }
    DO(p, true) holder = HOLDER_OF(p); gap[p] = 0 }
#endif
}

proctype Python(byte p)
{
    bit got;
    exists -> skip;
    do
    :: DO(p, MAY_TRY(p) && born) busy[p] = 1; excused[p] = 0; COUNT_TRY(p) }
       got = 0;
       if
       :: DO(p, sem > 0) sem--; inside[p] = 1; gap[p] = 1; got = 1; FORGET(p) }
          words_in(p)
       :: DO(p, sem == 0)
              if
              :: missed[p] && SAME(p)
              :: else -> NOTE(p)
              fi }
          if
          /* the time limit runs out; nobody who is at work stays so long between the semaphore and its words */
          :: DO(p, !(GAPS(p) && holder == 0 && noted_holder[p] == 0)) skip }
             if
             :: DO(p, !aged[p]) skip }
             :: DO(p, aged[p] && repair) skip }
             :: DO(p, aged[p] && !repair) repair = 1 }
                if
                :: DO(p, sem > 0) sem--; inside[p] = 1; gap[p] = 1; got = 1; FORGET(p) }
                   words_in(p);
                :: DO(p, sem == 0 && !SAME(p)) NOTE(p) }
                :: DO(p, sem == 0 && SAME(p) && !(GAPS(p) && holder == 0 && noted_holder[p] == 0)) assert(!WRONG(p)); excused[p] = 1; inside[p] = 1; gap[p] = 1; got = 1; FORGET(p) }
                   words_in(p);
                   DO(p, true) recoveries = 1 }
                fi;
                DO(p, true) repair = 0 }
             fi
          fi
       fi;
       if
       :: DO(p, got) skip }
progress_python:
          DO(p, true) holder = 0; gap[p] = 1 }
          DO(p, true) sem++; inside[p] = 0; gap[p] = 0 }
          /* take_surplus */
          if
          :: DO(p, recoveries == 0 || sem <= 1) skip }
          :: DO(p, recoveries && sem > 1) sem--; inside[p] = 1; gap[p] = 1 }
             do
             :: DO(p, sem > 0) sem-- }
             :: DO(p, sem == 0) break }
             od;
             DO(p, true) sem++; inside[p] = 0; gap[p] = 0 }
          fi
       :: DO(p, !got) skip }   /* goes on without it */
#ifdef F_BY_COMPLETED
          DO(p, true) completed = (completed + 1) % COUNTS }
#endif
       fi;
       DO(p, true) busy[p] = 0; got = 0 }
    :: DO(p, missed[p] && !aged[p] && CALM(p)) aged[p] = 1 }   /* a second */
    :: DO(p, missed[p] && !aged[p] && PID_IS_DEAD && CALM(p)) aged[p] = 1 }
    :: DO(p, tries[p] == TRIES) ended[p] = 1; break }
    od
}

inline l_try() {
    if
    :: DO(L, sem > 0) sem--; inside[L] = 1; gap[L] = 1; FORGET(L) }
progress_plc:
       words_in(L);
       if
       :: DO(L, recoveries && sem > 0) sem-- }
       :: DO(L, !(recoveries && sem > 0)) skip }
       fi;
       DO(L, true) holder = 0; gap[L] = 1 }
       DO(L, true) sem++; inside[L] = 0; gap[L] = 0 }
    :: DO(L, sem == 0 && !(missed[L] && SAME(L))) NOTE(L) }
    :: DO(L, sem == 0 && missed[L] && SAME(L) && !aged[L]) skip }
    :: DO(L, sem == 0 && missed[L] && SAME(L) && aged[L] && !(GAPS(L) && holder == 0 && noted_holder[L] == 0)) assert(!WRONG(L)); FORGET(L) }
       DO(L, true) holder = 0 }
       DO(L, true) recoveries = 1 }
       DO(L, true) sem++ }
    fi
}

proctype Plc()
{
    DO(L, true) busy[L] = 1 }
#ifdef MAKES
    /* SysSemProcessCreate: born 1, or at some runtimes 0 */
    atomic { if :: sem = 1 :: sem = 0 fi; exists = 1; born = 1 }
    if
    :: DO(L, sem > 0) sem-- }
    :: DO(L, sem == 0) skip }
#ifndef F_NEW_NOT_COUNTED
       DO(L, true) recoveries = 1 }
#endif
    fi;
    DO(L, true) sem++ }
#endif
    DO(L, true) busy[L] = 0 }
    do
    :: DO(L, MAY_TRY(L)) busy[L] = 1; excused[L] = 0; COUNT_TRY(L) }
       l_try();
       DO(L, true) busy[L] = 0 }
#ifdef F_SPARSE
    :: DO(L, !busy[L] && missed[L] && !aged[L] && CALM(L)) aged[L] = 1 }
#else
    /* a second: whoever has missed it tries in every cycle, so it would have got in */
    :: DO(L, !busy[L] && missed[L] && !aged[L] && CALM(L) && sem == 0) if :: SAME(L) -> aged[L] = 1 :: else -> NOTE(L) fi }
    :: DO(L, !busy[L] && missed[L] && CALM(L) && sem > 0) FORGET(L) }
#endif
    :: DO(L, tries[L] == TRIES) ended[L] = 1; break }
    od
}

/* When all is quiet: one token, or none because somebody died with it and the next to try heals; never two for good. */
proctype Judge()
{
    timeout -> assert(sem <= 1 || recoveries);
    assert(sem >= 1 || slow || dead[P] || dead[Q] || dead[L])
}

init {
    atomic {
#ifndef MAKES
        sem = 1; exists = 1; born = 1;
#endif
        run Python(P);
#ifndef WITHOUT_Q
        run Python(Q);
#endif
        run Plc(); run Fate(); run Judge()
    }
}
