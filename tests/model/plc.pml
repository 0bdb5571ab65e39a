/* The PLC, as in FB_ShmRegion.st.j2: one Cycle and perhaps one write at a time. */

#define OPENING  0
#define CLAIMING 1
#define CLAIMED  2
#define RUNNING  3
byte l_state, l_seen, l_beat, l_number, l_last, l_tag, l_cycles = CYCLES, l_closes = CLOSES;
byte l_holder, l_count, l_first;
bit l_taken, l_aged, l_missed, l_heal, l_got;

inline l_lock() {
    if
#ifdef NOLOCK
    :: DO(L, true) l_got = 1 }
#else
    :: DO(L, DRAINED(L) && sem > 0) sem--; l_got = 1; ENTER(L); l_missed = 0; l_heal = 0; l_holder = 0; l_count = 0;
           if :: mem[RECOV] && sem > 0 -> sem-- :: else fi }
    :: DO(L, sem == 0 && l_heal && SAME(l_holder, l_count) && DRAINED(L))
           l_got = 0; l_missed = 0; l_heal = 0; l_holder = 0; l_count = 0; mem[RECOV] = 1 }
       DO(L, true) LEAVE(L) }
    :: DO(L, sem == 0 && !(l_heal && SAME(l_holder, l_count)))
           l_got = 0; l_missed = 1; l_heal = 0; l_holder = mem[HOLDER]; l_count = mem[COUNT] }
#endif
    fi
}

inline l_unlock() {
#ifndef NOLOCK
    DO(L, DRAINED(L)) LEAVE(L); l_got = 0; busy[L] = 0; l_number = 0; l_tag = 0 }
#else
    DO(L, DRAINED(L)) l_got = 0; busy[L] = 0; l_number = 0; l_tag = 0 }
#endif
}

#define GIVE_WAY l_first = 0; l_beat = LD(L, BEAT); l_seen = LD(L, WRITER); l_aged = 0; l_state = CLAIMING
#ifdef F_BEAT_ONLY   /* today CLAIMING looks at the heartbeat only */
#define QUIET (LD(L, BEAT) == l_beat)
#else
#define QUIET (LD(L, BEAT) == l_beat && LD(L, WRITER) == l_seen)
#endif
#ifdef START_L   /* what it wipes off is its own name, unless it stood still between look and store */
#define CLOSES_OWN assert(mem[WRITER] == L + 1 || slept[L])
#else
#define CLOSES_OWN skip
#endif
#define REST DO(L, DRAINED(L)) busy[L] = 0 }

inline l_write() {
#ifdef F_NUMBER_FROM_COMPLETED
    DO(L, true) l_number = NEXT(LD(L, COMPLETED));
#else
    DO(L, true) l_number = NEXT(l_last);
#endif
        assert(!zone[P] || dead[P] || slept[P] || slept[L]);
        if :: mem[WRITER] != L + 1 -> late = 1 :: else fi;
#ifdef F_BEGUN_LEAPS
        l_number = (l_first -> l_first : l_number); ST(L, BEGUN, l_number);
#else
        ST(L, BEGUN, l_number); l_number = (l_first -> l_first : l_number);
#endif
        tags++; l_tag = tags }
    FENCE_L
    DO(L, true) ST(L, NUMBER(l_number), l_number) }
    DO(L, true) ST(L, HALF1(l_number), l_tag) }
    DO(L, true) ST(L, HALF2(l_number), l_tag) }
    if
#ifndef F_NO_VOID
    :: DO(L, LD(L, WRITER) != L + 1) ST(L, NUMBER(l_number), 0); late = 1; GIVE_WAY }
       DO(L, DRAINED(L)) ALONE(L); goto done }
    :: DO(L, LD(L, WRITER) == L + 1) ALONE(L) }
#else
    :: DO(L, true) ALONE(L) }
#endif
    fi;
    FENCE_L
    if
    :: DO(L, !l_first) ST(L, COMPLETED, l_number); COMPLETES(L); l_last = l_number }
#ifdef F_PAIR_APART   /* a PLC of 32 bits */
    :: DO(L, l_first) ST(L, BEGUN, l_number) }
       DO(L, true) ST(L, COMPLETED, l_number); COMPLETES(L); l_last = l_number; l_first = 0 }
#else
    :: DO(L, l_first) ST_PAIR(L, l_number); COMPLETES(L); l_last = l_number; l_first = 0 }
#endif
    fi;
done:
    skip
}

proctype Plc()
{
    do
    :: DO(L, l_cycles > 0) busy[L] = 1; slept[L] = 0; l_cycles--; cycled = 1 }
       if
       :: DO(L, l_state == OPENING) l_beat = LD(L, BEAT); l_seen = LD(L, WRITER); l_state = CLAIMING;
              l_aged = (l_seen == 0) }
          REST
       :: DO(L, l_state >= CLAIMING && l_state <= CLAIMED && !QUIET) GIVE_WAY }
          REST
       :: DO(L, l_state == CLAIMING && QUIET && l_aged) skip }
          DO(L, true) ST(L, WRITER, L + 1); l_state = CLAIMED; l_aged = 0; l_taken = l_seen != 0; l_seen = L + 1 }
          REST
       :: DO(L, l_state == CLAIMED && QUIET && l_aged) l_last = LD(L, COMPLETED); l_first = FIRST(L, l_last);
              l_last = ALWAYS(l_taken, l_last); l_seen = 0; l_state = RUNNING;
              l_aged = 0; l_beat++; ST(L, BEAT, l_beat) }
          REST
       :: DO(L, l_state >= CLAIMING && l_state <= CLAIMED && QUIET && !l_aged) skip }
          l_lock();   /* Probe */
          if
          :: DO(L, l_got) skip }
             l_unlock()
          :: DO(L, !l_got) busy[L] = 0 }
          fi
       :: DO(L, l_state == RUNNING && (LD(L, WRITER) != L + 1 || LD(L, BEAT) != l_beat)) GIVE_WAY }
          REST
       :: DO(L, l_state == RUNNING && LD(L, WRITER) == L + 1 && LD(L, BEAT) == l_beat) l_beat++; ST(L, BEAT, l_beat) }
          if
          :: REST   /* nothing to send in this cycle */
          :: l_lock();
             if
             :: DO(L, !l_got) skip }
                REST
             :: DO(L, l_got) skip }
                if
#ifndef F_NO_LOOK
                :: DO(L, LD(L, WRITER) != L + 1) GIVE_WAY }
                :: DO(L, LD(L, WRITER) == L + 1) zone[L] = 1 }
                   l_write()
#else
                :: DO(L, true) zone[L] = 1 }
                   l_write()
#endif
                fi;
                l_unlock()
             fi
          fi
       fi
    :: DO(L, !busy[L] && (l_state == CLAIMING || l_state == CLAIMED) && !l_aged && !AT_WORK(P) && !AT_WORK(R)) l_aged = 1 }
#ifdef F_NO_CONFIRM
    :: DO(L, !busy[L] && l_state == CLAIMED && !l_aged) l_aged = 1 }
#endif
    :: DO(L, !busy[L] && l_missed && !l_heal && !AT_WORK(P) && !AT_WORK(R)) l_heal = 1 }
    :: DO(L, !busy[L] && l_closes > 0 && l_state != OPENING) l_closes--; busy[L] = 1; slept[L] = 0 }
       if
#ifdef F_CLOSE_ANY
       :: DO(L, l_state >= CLAIMED) CLOSES_OWN; ST(L, WRITER, 0) }
#else
       :: DO(L, l_state == RUNNING && LD(L, WRITER) == L + 1) skip }
          DO(L, true) CLOSES_OWN; ST(L, WRITER, 0) }
       :: DO(L, l_state == CLAIMED || l_state == RUNNING && !(LD(L, WRITER) == L + 1)) skip }
#endif
       :: DO(L, l_state < CLAIMED) skip }
       fi;
       DO(L, DRAINED(L)) l_state = OPENING; l_first = 0; l_aged = 0; busy[L] = 0; l_missed = 0; l_heal = 0; l_seen = 0; l_beat = 0 }
    :: DO(L, l_cycles == 0 && !busy[L]) ended[L] = 1; break }
    od
}

