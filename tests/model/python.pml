/* The Python ends, as in runtime/publisher.py, lock.py and subscriber.py. */

#ifdef START_L   /* a PLC that runs is left alone; while it claims itself its heartbeat stands still */
#define TAKES_OVER assert(stalls < STALLS || ended[L] || dead[L] || l_state != RUNNING)
#else
#define TAKES_OVER skip
#endif

/* ---- Publisher ---- */
byte p_holder, p_count, p_sequence, p_first, p_beat, p_number, p_tries, p_tag, p_seen;
bit p_noted, p_aged, p_inside;

/* acquire(False) or self._wait(): a wait that ends well is a try made later. */
inline p_acquire() {
    if
#ifdef NOLOCK
    :: DO(P, true) p_inside = 0 }
#else
    :: DO(P, DRAINED(P) && sem > 0) sem--; p_inside = 1; ENTER(P); p_noted = 0; p_aged = 0; p_holder = 0; p_count = 0 }
    :: DO(P, sem == 0 && p_aged && SAME(p_holder, p_count) && DRAINED(P))
           /* _take_over */
           p_inside = 1; ENTER(P); mem[RECOV] = 1; p_noted = 0; p_aged = 0; p_holder = 0; p_count = 0 }
    :: DO(P, sem == 0 && !(p_aged && SAME(p_holder, p_count)))
           p_inside = 0; p_aged = 0; p_noted = 1; p_holder = mem[HOLDER]; p_count = mem[COUNT] }
#endif
    fi
}

inline p_release() {
    DO(P, DRAINED(P))
        if
        :: p_inside -> LEAVE(P); if :: mem[RECOV] && sem > 1 -> sem = 1 :: else fi   /* take_surplus */
        :: else
        fi;
        p_inside = 0; p_number = 0; p_tag = 0; busy[P] = 0 }
}

proctype Python()
{
    byte opens = OPENS;
#ifdef START_P
    goto opened;
#endif
open:
    if
    :: DO(P, opens > 0) opens--; busy[P] = 1; slept[P] = 0; p_tries = PUBLISHES;
           p_seen = LD(P, WRITER); p_beat = LD(P, BEAT); cycled = 0 }
    :: DO(P, opens == 0) goto over }
    fi;
    if
    :: DO(P, p_seen == L + 1) busy[P] = 0 }
       /* A second of watching, in which a PLC that runs makes a cycle. */
       DO(P, !AT_WORK(L) && !AT_WORK(R)
#ifndef F_SHORT_WATCH
          && (cycled && l_state != CLAIMED || stalled[L] || dead[L] || ended[L])
#endif
          ) busy[P] = 1 }
       if
       :: DO(P, LD(P, BEAT) != p_beat || LD(P, WRITER) != p_seen) busy[P] = 0; goto open }
       :: DO(P, LD(P, BEAT) == p_beat && LD(P, WRITER) == p_seen) skip }
       fi;
       DO(P, true) TAKES_OVER; ST(P, WRITER, P + 1) }
    :: DO(P, p_seen != L + 1) ST(P, WRITER, P + 1) }
    fi;
#ifndef F_NO_CONFIRM
    if
    :: DO(P, p_seen == L + 1 || slept[P]) skip }
       DO(P, DRAINED(P)) busy[P] = 0 }
       DO(P, !AT_WORK(L)) busy[P] = 1 }
       if
       :: DO(P, LD(P, WRITER) != P + 1) busy[P] = 0; goto open }
       :: DO(P, LD(P, WRITER) == P + 1) skip }
       fi
    :: DO(P, p_seen != L + 1 && !slept[P]) skip }
    fi;
#endif
    DO(P, DRAINED(P)) 
        p_sequence = LD(P, COMPLETED); p_first = FIRST(P, p_sequence);
        p_sequence = ALWAYS(p_seen == L + 1 || slept[P], p_sequence); p_beat = LD(P, BEAT); busy[P] = 0; p_seen = 0 }
opened:
    do
    :: DO(P, p_tries > 0) p_tries--; busy[P] = 1; slept[P] = 0; p_number = NEXT(p_sequence) }
       p_acquire();
#if defined(WEAK) && !defined(F_WITHOUT_LOCK) && !defined(NOLOCK)   /* LockTimeout: here nobody goes on without the lock */
       if
       :: DO(P, !p_inside) goto release }
       :: DO(P, p_inside) skip }
       fi;
#endif
#ifndef F_NO_LOOK
       if
       :: DO(P, LD(P, WRITER) != P + 1) p_tries = 0; goto release }
       :: DO(P, LD(P, WRITER) == P + 1) zone[P] = 1 }
       fi;
#else
       DO(P, true) zone[P] = 1 }
#endif
       DO(P, true) ST(P, BEAT, p_beat + 1); p_beat++ }
#ifndef F_NUMBER_NOT_FIRST
       if
       :: DO(P, p_first) ST(P, NUMBER(p_number), p_first) }
       :: DO(P, !p_first) skip }
       fi;
#endif
       DO(P, true)
           assert(!zone[L] || dead[L] || slept[P] || slept[L]);
           if :: mem[WRITER] != P + 1 -> late = 1 :: else fi;
#ifdef F_BEGUN_LEAPS
           p_number = (p_first -> p_first : p_number); ST(P, BEGUN, p_number);
#else
           ST(P, BEGUN, p_number); p_number = (p_first -> p_first : p_number);
#endif
           tags++; p_tag = tags }
       FENCE_P
       if   /* memcpy promises no order */
       :: DO(P, true) ST(P, NUMBER(p_number), p_number) }
          DO(P, true) ST(P, HALF1(p_number), p_tag) }
          DO(P, true) ST(P, HALF2(p_number), p_tag) }
       :: DO(P, true) ST(P, HALF1(p_number), p_tag) }
          DO(P, true) ST(P, HALF2(p_number), p_tag) }
          DO(P, true) ST(P, NUMBER(p_number), p_number) }
       fi;
       FENCE_P
       if
#ifndef F_NO_VOID
       :: DO(P, LD(P, WRITER) != P + 1) ST(P, NUMBER(p_number), 0); p_tries = 0; late = 1; goto voided }
       :: DO(P, LD(P, WRITER) == P + 1) ALONE(P) }
#else
       :: DO(P, true) ALONE(P) }
#endif
       fi;
       if
       :: DO(P, !p_first) ST(P, COMPLETED, p_number); COMPLETES(P); p_sequence = p_number; goto release }
       :: DO(P, p_first) ST_PAIR(P, p_number); COMPLETES(P); p_sequence = p_number; p_first = 0; goto release }
       fi;
voided:
       DO(P, DRAINED(P)) ALONE(P) }
release:
       p_release()
    :: DO(P, p_noted && !p_aged && !AT_WORK(L) && !AT_WORK(R)) p_aged = 1 }
    :: DO(P, p_tries == 0) p_sequence = 0; p_first = 0; p_beat = 0; p_noted = 0; p_aged = 0; p_holder = 0; p_count = 0; goto open }
    od;
over:
    ended[P] = 1
}

/* ---- Subscriber._copy ---- */
byte r_number, r_found, r_one, r_two, r_last, r_reads = READS;
bit r_inside, r_whole;
#ifdef LOADS_PASS
bit r_done[4];
#endif

proctype Reader()
{
    do
    :: DO(R, r_reads > 0 && mem[COMPLETED] != r_last && mem[COMPLETED] != 0)
           busy[R] = 1; r_reads--; r_number = mem[COMPLETED] }
       if
#ifdef NOLOCK
       :: DO(R, true) r_inside = 0 }
#else
       :: DO(R, sem > 0) sem--; r_inside = 1; ENTER(R) }
#if !defined(WEAK) || defined(F_WITHOUT_LOCK)   /* not free; or left alone, as C does at its first try */
       :: DO(R, true) r_inside = 0 }
#endif
#endif
       fi;
#ifdef LOADS_PASS   /* between the two operations of the lock, in any order */
       do
       :: DO(R, !r_done[0]) r_done[0] = 1; r_one = mem[HALF1(r_number)] }
       :: DO(R, !r_done[1]) r_done[1] = 1; r_two = mem[HALF2(r_number)] }
       :: DO(R, !r_done[2]) r_done[2] = 1; r_found = mem[NUMBER(r_number)] }
       :: DO(R, !r_done[3]) r_done[3] = 1; r_whole = DISTANCE(r_number, mem[BEGUN]) < 2 }
       :: DO(R, r_done[0] && r_done[1] && r_done[2] && r_done[3])
              r_done[0] = 0; r_done[1] = 0; r_done[2] = 0; r_done[3] = 0; break }
       od;
       DO(R, true)
#else
#ifdef F_NUMBER_BEFORE_COPY
       DO(R, true) r_found = mem[NUMBER(r_number)] }
#endif
       DO(R, true) r_one = mem[HALF1(r_number)] }
       DO(R, true) r_two = mem[HALF2(r_number)] }
#ifdef F_NUMBER_BEFORE_BEGUN
       DO(R, true) r_found = mem[NUMBER(r_number)] }
#endif
       DO(R, true) r_whole = DISTANCE(r_number, mem[BEGUN]) < 2 }
#if defined(F_NUMBER_BEFORE_BEGUN) || defined(F_NUMBER_BEFORE_COPY)
       DO(R, true)
#else
       DO(R, true) r_found = mem[NUMBER(r_number)];
#endif
#endif
           if
           :: r_whole && r_found == r_number -> assert(r_one == r_two && r_one != 0); assert(r_last == 0 || NEWER(r_number, r_last)); r_last = r_number
           :: else
           fi;
           if
           :: r_inside -> LEAVE(R); r_inside = 0; if :: mem[RECOV] && sem > 1 -> sem = 1 :: else fi
           :: else
           fi;
           busy[R] = 0; r_number = 0; r_whole = 0; r_found = 0; r_one = 0; r_two = 0 }
    :: DO(R, r_reads == 0) ended[R] = 1; break }
    od
}

