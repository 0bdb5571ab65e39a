/* A service: two clients that change over, A in Python and B a PLC, two servers, S in Python and T a PLC; two regions.
 *
 * A sample is one step here (writers.pml has its parts), so are the rest of a copy and the look after it. Claim, looks,
 * numbers, and what each end does with them are as in runtime/calls.py, FB_ShmClient and FB_ShmServer. No lock: what holds
 * here holds with it.
 */
#define A 0
#define B 1
#define S 2
#define T 3
#define REQUEST  0
#define RESPONSE 1
#define IS_PLC(p) ((p) % 2)
#define OTHER(p) ((p) - (p) % 2 + 1 - (p) % 2)

#ifndef CALLS
#define CALLS 1      /* of each client, each time it is opened */
#endif
#ifndef OPENS
#define OPENS 1
#endif
#ifndef TAKES
#define TAKES 2      /* looks for a call, each time a server is opened */
#endif
#ifndef STALLS
#define STALLS 1
#endif
#ifndef CRASHES
#define CRASHES 0
#endif

byte writer[2], completed[2];
bit moved[2];                    /* the heartbeat, since it was noted last */
byte number[4], call[4], id[4];  /* of the slots: 2 * region + number % 2; `call` is what a reply says */

byte stalls = STALLS, crashes = CRASHES, ids;
bit busy[4], stalled[4], slept[4], ended[4];   /* ended, or between two lives */
byte life[4];                    /* who has died starts again, if it may still open, and remembers nothing */
bit served[16];
byte seen[4], sequence[4], jump[4], last[4], opens[4], left[4];
byte job[4], job_id[4];          /* a client's call that waits, a server's that it has taken */
bit lost[4];

#define AT_WORK(p) (busy[p] && !stalled[p])
#define DO(p, c) atomic { !stalled[p] && life[p] == mine && (c) ->
#define SLOT(r, n) (2 * (r) + (n) % 2)
#ifdef F_NO_LEAP
#define LEAP(r, c) 0
#else
#define LEAP(r, c) (number[SLOT(r, (c) + 1)] > (c) -> number[SLOT(r, (c) + 1)] + 2 - ((c) + 1) : 0)
#endif

proctype Fate()
{
    byte p;
    do
    :: atomic { stalls > 0 -> if :: p = A :: p = B :: p = S :: p = T fi;
           if :: AT_WORK(p) -> stalls--; stalled[p] = 1; slept[p] = 1 fi; p = 0 }
    :: atomic { if :: stalled[A] -> stalled[A] = 0 :: stalled[B] -> stalled[B] = 0
                   :: stalled[S] -> stalled[S] = 0 :: stalled[T] -> stalled[T] = 0 fi }
    :: atomic { crashes > 0 -> if :: p = A :: p = B :: p = S :: p = T fi;
           if :: AT_WORK(p) -> crashes--; life[p]++; busy[p] = 0; lost[p] = 0; ended[p] = 1;
                  if
                  :: opens[p] > 0 && p < S -> run Client(p, life[p])
                  :: opens[p] > 0 && p >= S -> run Server(p, life[p])
                  :: else
                  fi
           fi; p = 0 }
    od
}

inline skip_all(p) {
#ifdef F_READ_NOT_SKIPPED   /* the lock is needed and not free: nothing is read */
    if :: last[p] = completed[REQUEST] :: completed[REQUEST] -> last[p] = completed[REQUEST] - 1 fi
#else
    last[p] = completed[REQUEST]
#endif
}

#ifdef F_SKIPS_ONCE
#define SKIP_AGAIN skip
#else
#define SKIP_AGAIN skip_all(p)   /* a PLC may have taken what came meanwhile */
#endif

inline claim(p, r) {
    skip;
again:
    DO(p, true) busy[p] = 1; slept[p] = 0; lost[p] = 0; seen[p] = writer[r]; moved[r] = 0 }
    if
    :: DO(p, seen[p] == 0 || (!IS_PLC(p) && seen[p] == p + 1)) skip }
    :: DO(p, !(seen[p] == 0 || (!IS_PLC(p) && seen[p] == p + 1))) busy[p] = 0 }
       /* a second; a PLC that runs moves its heartbeat in it */
       DO(p, !AT_WORK(OTHER(p)) && (IS_PLC(p) || stalled[OTHER(p)] || ended[OTHER(p)])) busy[p] = 1 }
       if
       :: DO(p, moved[r] || writer[r] != seen[p]) busy[p] = 0; goto again }
       :: DO(p, !moved[r] && writer[r] == seen[p]) skip }
       fi
    fi;
    DO(p, true) writer[r] = p + 1 }
    if
    :: DO(p, !(IS_PLC(p) || seen[p] == OTHER(p) + 1 || slept[p])) jump[p] = 0 }
    :: DO(p, IS_PLC(p) || seen[p] == OTHER(p) + 1 || slept[p]) jump[p] = 1; busy[p] = 0 }
       DO(p, !AT_WORK(OTHER(p))) busy[p] = 1; if :: p == T -> skip_all(T) :: else fi }
       if
       :: DO(p, writer[r] != p + 1 || (IS_PLC(p) && moved[r])) busy[p] = 0; goto again }
       :: DO(p, writer[r] == p + 1 && !(IS_PLC(p) && moved[r])) skip }
       fi
    fi;
    DO(p, true) if :: r == RESPONSE && !IS_PLC(p) && jump[p] -> SKIP_AGAIN :: else fi;
        sequence[p] = completed[r]; jump[p] = LEAP(r, sequence[p]); seen[p] = 0 }
}

inline publish(p, r, what, which) {
#ifdef F_NO_LOOK
    DO(p, true) slept[p] = 0; moved[r] = 1 }
#else
    DO(p, true) slept[p] = 0; if :: writer[r] != p + 1 -> lost[p] = 1 :: else -> moved[r] = 1 fi }
#endif
    if
    :: DO(p, lost[p]) skip }
    :: DO(p, !lost[p])
           sequence[p] = sequence[p] + 1 + jump[p];
           if :: r == REQUEST -> ids++; job_id[p] = ids :: else fi;
           number[SLOT(r, sequence[p])] = sequence[p];
           call[SLOT(r, sequence[p])] = what; id[SLOT(r, sequence[p])] = job_id[p];
#ifndef F_NO_VOID
           if :: writer[r] != p + 1 -> lost[p] = 1; number[SLOT(r, sequence[p])] = 0 :: else fi
#endif
       }
       if
       :: DO(p, lost[p]) skip }
       :: DO(p, !lost[p]) completed[r] = sequence[p]; jump[p] = 0 }
       fi
    fi
}

#ifdef F_ANY_REPLY
#define ANSWERS(p, n) true
#else
#define ANSWERS(p, n) (call[SLOT(RESPONSE, n)] == job[p])
#endif

proctype Client(byte p, mine)
{
    byte newest;
open:
    DO(p, opens[p] > 0) opens[p]--; ended[p] = 0; left[p] = CALLS; job[p] = 0; job_id[p] = 0; last[p] = 0 }
    claim(p, REQUEST);
    DO(p, true) busy[p] = 0 }
    do
    :: DO(p, left[p] > 0 && !lost[p]) left[p]--; busy[p] = 1; job[p] = 0; last[p] = completed[RESPONSE] }
       publish(p, REQUEST, 0, 0);
       DO(p, true) busy[p] = 0; job[p] = (lost[p] -> 0 : sequence[p]) }
    /* a reply; or none in time, which changes nothing but what is sent next */
    :: DO(p, job[p] && completed[RESPONSE] != last[p] && !busy[p]) newest = completed[RESPONSE];
           last[p] = newest;
           if
           :: number[SLOT(RESPONSE, newest)] == newest && ANSWERS(p, newest) ->
              assert(id[SLOT(RESPONSE, newest)] == job_id[p]); job[p] = 0; job_id[p] = 0
           :: else
           fi; newest = 0 }
    :: DO(p, lost[p] || left[p] == 0) busy[p] = 0; if :: opens[p] > 0 -> goto open :: else -> goto over fi }
    od;
over:
    DO(p, true) ended[p] = 1 }
}

proctype Server(byte p, mine)
{
    byte newest;
open:
    DO(p, opens[p] > 0) opens[p]--; ended[p] = 0; left[p] = TAKES; job[p] = 0; job_id[p] = 0; skip_all(p) }
    claim(p, RESPONSE);
    DO(p, true) busy[p] = 0 }
    do
    :: DO(p, left[p] > 0 && !lost[p] && job[p] == 0) left[p]--; busy[p] = 1; slept[p] = 0 }
       /* heartbeat, or Beat */
       DO(p, true) if :: writer[RESPONSE] != p + 1 -> lost[p] = 1 :: else -> moved[RESPONSE] = 1 fi }
       if
       :: DO(p, lost[p] || completed[REQUEST] == last[p]) skip }
       :: DO(p, !lost[p] && completed[REQUEST] != last[p]) newest = completed[REQUEST];
              if
              :: number[SLOT(REQUEST, newest)] == newest ->
                 last[p] = newest; job[p] = newest; job_id[p] = id[SLOT(REQUEST, newest)]
              :: else
              fi; newest = 0 }
#ifndef F_TAKEN_UNLOOKED
          DO(p, true) if :: writer[RESPONSE] != p + 1 -> lost[p] = 1; job[p] = 0; job_id[p] = 0 :: else fi }
#endif
          if
          :: DO(p, job[p]) assert(!served[job_id[p]]); served[job_id[p]] = 1 }
             publish(p, RESPONSE, job[p], 0);
             DO(p, true) job[p] = 0; job_id[p] = 0 }
          :: DO(p, !job[p]) skip }
          fi
       fi;
       DO(p, true) busy[p] = 0 }
    :: DO(p, lost[p] || left[p] == 0) busy[p] = 0; if :: opens[p] > 0 -> goto open :: else -> goto over fi }
    od;
over:
    DO(p, true) ended[p] = 1 }
}

init {
    atomic {
        opens[A] = OPENS; opens[B] = OPENS; opens[S] = OPENS; opens[T] = OPENS;
#ifdef CLIENTS
        run Client(B, 0);
#endif
#ifdef SERVERS
        run Server(T, 0);
#endif
        run Client(A, 0); run Server(S, 0); run Fate()
    }
}
