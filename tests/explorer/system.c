/* Simulated calls of Linux and the C library, except files: semaphores, futexes, clocks and processes.
 *
 * The linker prefers these functions to those of the C library. Each call is a step, except reading a clock.
 */
#define _GNU_SOURCE
#include "explorer.h"

#include <errno.h>
#include <linux/futex.h>
#include <semaphore.h>
#include <stdarg.h>
#include <sys/syscall.h>
#include <time.h>

/* --- semaphores and futexes -------------------------------------------------------------------------------- */

static bool take_token(sem_t *semaphore)
{
    const uint32_t value = (uint32_t)get(semaphore, 4);
    if (value == 0)
        return false;
    put(semaphore, value - 1, 4);
    return true;
}

int sem_trywait(sem_t *semaphore)
{
    bool acquired;
    step();
    if ((uint32_t)get(semaphore, 4) != 0)
        flush_stores(self); /* a locked instruction; without a token, only a load */
    acquired = take_token(semaphore);
    observe('s', semaphore, acquired);
    trace(acquired ? "acquires %s" : "%s is not free", name_of(semaphore));
    errno = EAGAIN;
    return acquired ? 0 : -1;
}

int sem_clockwait(sem_t *semaphore, clockid_t clock_id, const struct timespec *until)
{
    const sleep_word word = {semaphore, 0, false};
    bool acquired;
    (void)clock_id;
    finish_access();
    trace("waits for %s", name_of(semaphore));
    sleep_until(until->tv_sec * INT64_C(1000000000) + until->tv_nsec, &word, 1);
    acquired = take_token(semaphore);
    trace(acquired ? "acquires %s" : "%s was not free in time", name_of(semaphore));
    errno = ETIMEDOUT;
    return acquired ? 0 : -1;
}

int sem_post(sem_t *semaphore)
{
    step();
    flush_stores(self);
    put(semaphore, get(semaphore, 4) + 1, 4);
    trace("posts %s", name_of(semaphore));
    if (get(semaphore, 8) >> 32 != 0) /* for futex_waitv; sem_clockwait checks the value */
        wake(semaphore, 1);
    return 0;
}

int sem_getvalue(sem_t *semaphore, int *value)
{
    step();
    *value = (int)get(semaphore, 4);
    observe('v', semaphore, (uint64_t)*value);
    return 0;
}

/* Like struct futex_waitv, which older headers lack. */
typedef struct waited { uint64_t value, at; uint32_t flags, reserved; } waited;

static long futex_waitv(const waited *waits, unsigned count, const struct timespec *until)
{
    sleep_word words[4];
    int which;
    for (unsigned i = 0; i < count; i++) {
        words[i] = (sleep_word){(const void *)(uintptr_t)waits[i].at, (uint32_t)waits[i].value, true};
        if ((uint32_t)get(words[i].at, 4) != words[i].value) {
            observe('f', words[i].at, 1);
            trace("futex: %s has already changed", name_of(words[i].at));
            errno = EAGAIN;
            return -1;
        }
    }
    trace("sleeps on %s", name_of(words[0].at));
    which = sleep_until(until ? until->tv_sec * INT64_C(1000000000) + until->tv_nsec : NEVER, words, (int)count);
    trace(which < 0 ? "wakes at the timeout" : "is woken");
    errno = ETIMEDOUT;
    return which;
}

long syscall(long number, ...)
{
    va_list values;
    long first, second, third, fourth;
    va_start(values, number);
    first = va_arg(values, long), second = va_arg(values, long), third = va_arg(values, long), fourth = va_arg(values, long);
    va_end(values);
    if (number == SYS_gettid)
        return PID_OF(self);
    step();
    flush_stores(self);
    if (number == 449) /* futex_waitv(words, count, flags, until, clock) */
        return futex_waitv((const waited *)first, (unsigned)second, (const struct timespec *)fourth);
    if (number == SYS_futex && (second & FUTEX_CMD_MASK) == FUTEX_WAKE)
        return wake((const void *)first, (int)third);
    if (number == SYS_futex && (second & FUTEX_CMD_MASK) == FUTEX_WAIT) {
        const waited word = {.value = (uint64_t)third, .at = (uint64_t)first};
        const struct timespec *ns = (const struct timespec *)fourth, until = {.tv_nsec = ns->tv_nsec + now};
        return futex_waitv(&word, 1, &until);
    }
    fail("system call %ld is not explored", number);
    return -1;
}

/* --- time and processes ------------------------------------------------------------------------------------ */

int clock_gettime(clockid_t clock_id, struct timespec *time)
{
    (void)clock_id;
    time->tv_sec = now / INT64_C(1000000000);
    time->tv_nsec = now % INT64_C(1000000000);
    observe('t', NULL, (uint64_t)now);
    return 0;
}

int nanosleep(const struct timespec *time, struct timespec *rest)
{
    (void)rest;
    finish_access();
    sleep_until(now + time->tv_sec * INT64_C(1000000000) + time->tv_nsec, NULL, 0);
    return 0;
}

int sched_yield(void)
{
    finish_access();
    pick_next_actor(true);
    return 0;
}

int getpid(void)
{
    return PID_OF(self);
}

int kill(int pid, int signal)
{
    const bool is_gone = !is_alive(pid - PID_OF(0));
    (void)signal;
    observe('p', NULL, is_gone);
    errno = ESRCH;
    return is_gone ? -1 : 0;
}
