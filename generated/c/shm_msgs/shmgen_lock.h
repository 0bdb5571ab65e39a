/* The lock of a region: tried, waited for with a limit, and healed (docs/protocol.md, "Lock" and "Healing").
 *
 * Made by shmgen; changes made here are lost.
 */
#ifndef SHMGEN_LOCK_H
#define SHMGEN_LOCK_H

#include "shmgen_link.h"

#include <sched.h>

#ifdef __cplusplus
extern "C" {
#endif

/* Tokens too many that one call takes away at most. */
#define SHMGEN_SURPLUS 64

#if defined(__GLIBC_PREREQ)
#if __GLIBC_PREREQ(2, 30)
#define SHMGEN_HAS_CLOCKWAIT 1
#if !defined(__USE_GNU) /* then <semaphore.h> does not show it */
extern int sem_clockwait(sem_t *semaphore, clockid_t clock, const struct timespec *until);
#endif
#endif
#endif

/* Waits so many ns for a token, by the clock that nobody sets; 0 is one try, without a system call. */
static inline bool shmgen_token(sem_t *semaphore, int64_t ns)
{
    int64_t end;
    if (sem_trywait(semaphore) == 0)
        return true;
    if (ns <= 0)
        return false;
    end = shmgen_now() + ns;
#ifdef SHMGEN_HAS_CLOCKWAIT
    struct timespec until;
    until.tv_sec = (time_t)(end / INT64_C(1000000000));
    until.tv_nsec = (long)(end % INT64_C(1000000000));
    while (sem_clockwait(semaphore, CLOCK_MONOTONIC, &until) != 0)
        if (errno != EINTR)
            return false;
    return true;
#else
    /* Not sem_timedwait: it waits until a time of day, and an hour longer if the clock is set back by one. */
    for (int yields = 20; sem_trywait(semaphore) != 0; yields--) {
        if (shmgen_now() >= end)
            return false;
        if (yields > 0)
            sched_yield();
        else
            shmgen_pause(SHMGEN_MS / 10);
    }
    return true;
#endif
}

/* Posts unless there is a token already: two would let two in, or end a later wait early. */
static inline bool shmgen_post(sem_t *semaphore)
{
    int value = 0;
    return (sem_getvalue(semaphore, &value) != 0 || value < 1) && sem_post(semaphore) == 0;
}

/* Notes which stay inside the lock lasts. Whoever gets in counts lock_count up and then writes its name: while both
 * stand, it is one and the same. */
static inline void shmgen_note_stay(shmgen_link *link)
{
    uint32_t holder = shmgen_load(link, SHMGEN_AT(lock_holder)), count = shmgen_load(link, SHMGEN_AT(lock_count));
    if (link->seen == 0 || holder != link->seen_holder || count != link->seen_count) {
        link->seen_holder = holder;
        link->seen_count = count;
        link->seen = 1;
        link->stood = shmgen_now();
    }
}

/* Whether that stay has lasted for so long that its holder must be dead. */
static inline bool shmgen_is_overdue(const shmgen_link *link)
{
    int64_t stood = shmgen_now() - link->stood;
    if (stood >= SHMGEN_HEAL_MS * SHMGEN_MS)
        return true;
    return stood >= SHMGEN_DEAD_MS * SHMGEN_MS && link->seen_holder != 0 && link->seen_holder < UINT32_C(0x80000000) &&
           kill((pid_t)link->seen_holder, 0) != 0 && errno == ESRCH;
}

/* Takes the dead holder's place, which the caller's shmgen_leave() then ends. One process at a time, and each looks
 * once more: had the one before only released, somebody who is in but has not counted yet would be taken for dead. */
static inline bool shmgen_take_over(shmgen_link *link, int64_t limit)
{
    bool inside;
    if (!shmgen_byte(link, SHMGEN_REPAIR_LOCK, F_WRLCK))
        return false;
    inside = shmgen_token(link->lock, limit);
    if (!inside && shmgen_load(link, SHMGEN_AT(lock_holder)) == link->seen_holder &&
        shmgen_load(link, SHMGEN_AT(lock_count)) == link->seen_count) {
        shmgen_store(link, SHMGEN_AT(lock_count), link->seen_count + 1);
        shmgen_store(link, SHMGEN_AT(lock_holder), link->pid);
        shmgen_store(link, SHMGEN_AT(recoveries), shmgen_load(link, SHMGEN_AT(recoveries)) + 1);
        inside = true;
    }
    shmgen_byte(link, SHMGEN_REPAIR_LOCK, F_UNLCK);
    return inside;
}

/* After a try that failed: waits, unless this same stay has been waited for already, and heals. */
static inline bool shmgen_wait_for_lock(shmgen_link *link, int64_t limit)
{
    shmgen_note_stay(link);
    if (limit > 0 && link->seen == 1) {
        link->seen = 2;
        if (shmgen_token(link->lock, limit))
            return true;
    }
    if (shmgen_is_overdue(link) && shmgen_take_over(link, limit))
        return true;
    link->misses++;
    return false;
}

/* Goes inside. False: the lock was not free in time, or there is none; see shmgen_may_go_on(). */
static inline bool shmgen_enter(shmgen_link *link, int64_t limit)
{
    if (link->lock == NULL)
        return false;
    if (sem_trywait(link->lock) != 0 && !shmgen_wait_for_lock(link, limit))
        return false;
    shmgen_store(link, SHMGEN_AT(lock_count), shmgen_load(link, SHMGEN_AT(lock_count)) + 1);
    shmgen_store(link, SHMGEN_AT(lock_holder), link->pid);
    return true;
}

/* Whether the slots alone carry integrity. */
static inline bool shmgen_may_go_on(const shmgen_link *link)
{
    return SHMGEN_KEEPS_ORDER || link->lock == NULL;
}

/* Comes out. Where a token is there already ours goes, and of others so many that the work stays bounded: a holder that
 * was taken for dead has come back, two sides have healed, or somebody has posted. */
static inline void shmgen_leave(shmgen_link *link)
{
    shmgen_store(link, SHMGEN_AT(lock_holder), 0);
    if (!shmgen_post(link->lock)) {
        for (int left = SHMGEN_SURPLUS; left > 0 && sem_trywait(link->lock) == 0; left--)
            ;
        shmgen_post(link->lock);
    }
}

/* Keeps later loads behind earlier stores. Where a semaphore was posted in between, x86 does so by itself. */
static inline void shmgen_fence(bool posted)
{
#if defined(__x86_64__) || defined(__i386__)
    if (posted)
        return;
#else
    (void)posted;
#endif
    __atomic_thread_fence(__ATOMIC_SEQ_CST);
}

#ifdef __cplusplus
}
#endif

#endif
