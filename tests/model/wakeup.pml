/* Waking a reader: a writer W, a reader R that waits, another reader S of the same region; `armed` and the event.
 *
 * A wake-up is lost if a reader sleeps while an unread sample is there and nobody will post any more. With one waiting
 * reader it never is, sequentially consistent and on TSO. With two (TWO), of which one may die, and where neither the
 * release of the lock nor a mutex keeps a later load behind a store (WEAK, as on aarch64), it may be, and then costs one
 * slice of 10 ms (BOUND): every reader has the last sample in the end.
 */
#define W 0
#define R 1
#define S 2
#define COMPLETED 0
#define ARMED 1
#define WORDS 2

#ifndef SAMPLES
#define SAMPLES 2
#endif
#ifndef CRASHES
#define CRASHES 0
#endif

byte mem[WORDS];
#ifdef SC
#define LD(p, a) (mem[a])
#define ST(p, a, v) mem[a] = v
#define DRAINED(p) true
#else   /* TSO; with two words in play a store that passes a store changes nothing but `completed` after `armed` */
chan buffer[3] = [4] of { byte, byte };
byte own[6], pending[6];
#define LD(p, a) (pending[(p) * WORDS + (a)] -> own[(p) * WORDS + (a)] : mem[a])
#define ST(p, a, v) own[(p) * WORDS + (a)] = v; pending[(p) * WORDS + (a)]++; buffer[p]!a,own[(p) * WORDS + (a)]
#define DRAINED(p) (len(buffer[p]) == 0)
proctype Drain(byte p)
{
    byte a, v;
end:
    do
    :: atomic {
           buffer[p]?a,v ->
           mem[a] = v;
           pending[p * WORDS + a]--;
           if
           :: pending[p * WORDS + a] == 0 -> own[p * WORDS + a] = 0
           :: else
           fi;
           a = 0; v = 0
       }
    od
}
#endif

byte event, crashes = CRASHES;
byte last[3], newest[3];
bit dead[3], asleep[3], finished, has_event[3];
#ifdef BOUND
#define SLICE_ENDS true
#else
#define SLICE_ENDS false   /* waits for ever, so that a lost wake-up shows */
#endif
#define DO(p, c) atomic { !dead[p] && (c) ->

proctype Writer()
{
    byte number;
    do
    :: DO(W, number < SAMPLES) number++; ST(W, COMPLETED, number) }
       /* the release of the lock, or a fence */
#if !defined(F_NO_FENCE_WRITER) && !defined(WEAK)
       DO(W, DRAINED(W)) skip }
#endif
       if
       :: DO(W, LD(W, ARMED)) ST(W, ARMED, 0) }
          DO(W, DRAINED(W)) if :: event < 3 -> event++ :: else fi }   /* sem_post is a locked instruction */
       :: DO(W, !LD(W, ARMED)) skip }
       fi
    :: DO(W, number == SAMPLES && DRAINED(W)) finished = 1; break }
    od
}

proctype Reader(byte p)
{
    do
    :: DO(p, true) newest[p] = LD(p, COMPLETED) }
       if
       :: DO(p, newest[p] != last[p]) last[p] = newest[p] }
       :: DO(p, newest[p] == last[p] && last[p] == SAMPLES) break }
       :: DO(p, newest[p] == last[p] && last[p] != SAMPLES && LD(p, ARMED)) asleep[p] = 1 }
          DO(p, true) asleep[p] = 0 }   /* another has the event: a look each millisecond */
       :: DO(p, newest[p] == last[p] && last[p] != SAMPLES && !LD(p, ARMED)) skip }
#ifndef F_NOT_ARMED
          DO(p, true) ST(p, ARMED, 1) }
#endif
#if !defined(F_NO_FENCE_READER) && !defined(WEAK)
          DO(p, DRAINED(p)) skip }
#endif
          if
#ifndef F_NO_SECOND_LOOK
          :: DO(p, LD(p, COMPLETED) != newest[p]) ST(p, ARMED, 0) }
          :: DO(p, LD(p, COMPLETED) == newest[p]) skip }
#else
          :: DO(p, true) skip }
#endif
             DO(p, true) asleep[p] = 1; has_event[p] = 1 }
             if
             :: DO(p, event > 0 && DRAINED(p)) event--; asleep[p] = 0; has_event[p] = 0 }
                if
                :: DO(p, LD(p, ARMED)) ST(p, ARMED, 0) }
                :: DO(p, !LD(p, ARMED)) skip }
                fi
             :: DO(p, SLICE_ENDS) asleep[p] = 0; has_event[p] = 0; ST(p, ARMED, 0) }
             fi
          fi
       fi
    od
}

proctype Fate()
{
    do
    :: atomic { crashes > 0 && !dead[S] -> crashes--; dead[S] = 1; asleep[S] = 0 }
    :: break
    od
}

/* The last sample is there, the writer is done, and a reader that has the event sleeps on. */
#define LOST(p) (finished && DRAINED(p) && asleep[p] && has_event[p] && event == 0 && last[p] != SAMPLES)

proctype Judge()
{
#ifdef BOUND   /* in whatever order: who sleeps no longer than a slice has the last sample in the end */
    timeout -> assert(last[R] == SAMPLES)
#else
    atomic { LOST(R) -> assert(false) }
#endif
}

init {
    atomic {
#ifndef SC
        run Drain(W); run Drain(R); run Drain(S);
#endif
        run Writer(); run Reader(R);
#ifdef TWO
        run Reader(S);
#endif
        run Fate(); run Judge()
    }
}
