/* A reader of a topic: the newest sample, every sample that is still there, or the next one as soon as it comes.
 *
 * Made by shmgen; changes made here are lost.
 */
#ifndef SHMGEN_SUBSCRIBER_H
#define SHMGEN_SUBSCRIBER_H

#include "shmgen_open.h"

#ifdef __cplusplus
extern "C" {
#endif

/* Messages up to so many bytes are looked at in a copy of their own, before they take the place of another. */
#define SHMGEN_SMALL 1024

/* For one thread at a time. `end.misses` counts locks not free in time, `end.refused` samples with a count too high. */
typedef struct shmgen_subscriber {
    shmgen_link end;
    uint64_t stamp;     /* ns since 1970 of the newest sample read, 0 = none */
    int64_t beat_since; /* ns */
    shmgen_status gone; /* what calls say once it is not open */
    uint32_t last;      /* number of the sample that counts as read last */
    uint32_t sequence;  /* number of the newest sample read, 0 = none yet */
    uint32_t missed;    /* samples that came and went unread */
    uint32_t beat;
    uint32_t reserved;
    shmgen_path path; /* the field whose count was too high */
} shmgen_subscriber;

/* Lets go of the region, which stays. Does nothing the second time. */
static inline void shmgen_subscriber_close(shmgen_subscriber *self)
{
    shmgen_link_close(&self->end);
    self->gone = SHMGEN_CLOSED;
}

/* Begins to open a topic without waiting: call shmgen_subscriber_step() in each cycle until it says SHMGEN_OK. */
static inline shmgen_status shmgen_subscriber_start(
    shmgen_subscriber *self, const char *topic, const shmgen_type *type, const shmgen_options *options)
{
    memset(self, 0, sizeof *self);
    shmgen_path_clear(&self->path);
    self->gone = shmgen_link_start(&self->end, topic, type, options);
    if (self->gone == SHMGEN_OK)
        self->gone = SHMGEN_OPENING;
    return self->gone;
}

/* One step of opening, which does not wait. The newest sample that is there already counts as unread. */
static inline shmgen_status shmgen_subscriber_step(shmgen_subscriber *self)
{
    if (self->end.step == SHMGEN_STEP_READY)
        return SHMGEN_OK;
    if (self->gone != SHMGEN_OPENING)
        return shmgen_why(self->gone);
    self->gone = shmgen_link_step(&self->end);
    if (self->gone == SHMGEN_OK) {
        uint32_t newest = shmgen_load(&self->end, SHMGEN_AT(completed));
        self->last = newest != 0 ? newest - 1 : 0;
        self->beat = shmgen_load(&self->end, SHMGEN_AT(heartbeat));
        self->beat_since = shmgen_now();
        self->end.step = SHMGEN_STEP_READY;
    }
    return self->gone;
}

/* Opens the region, or makes it when the writer comes later. `options` may be NULL. */
static inline shmgen_status shmgen_subscriber_open(
    shmgen_subscriber *self, const char *topic, const shmgen_type *type, const shmgen_options *options)
{
    shmgen_status status = shmgen_subscriber_start(self, topic, type, options);
    while (status == SHMGEN_OPENING) {
        uint32_t step = self->end.step;
        status = shmgen_subscriber_step(self);
        if (status == SHMGEN_OPENING && self->end.step == step)
            shmgen_pause(SHMGEN_MS);
    }
    return status;
}

/* Whether sample `number` lies whole in that slot: begun fewer than `slots` writes ago, and not voided since. */
static inline bool shmgen_is_whole(const shmgen_link *end, uint32_t number, size_t slot)
{
    uint32_t begun = shmgen_load(end, SHMGEN_AT(begun));
    uint32_t found = shmgen_load(end, slot + offsetof(shmgen_slot, number));
    return found == number && shmgen_steps(end, number, begun) < end->slots;
}

/* Copies sample `number`. SHMGEN_OVERWRITTEN: it is gone; what `into` holds is then nothing. */
static inline shmgen_status shmgen_copy(
    shmgen_subscriber *self, uint32_t number, void *into, size_t size, int64_t limit, uint64_t *stamp)
{
    shmgen_link *end = &self->end;
    const size_t slot = shmgen_slot_of(end, number);
    const bool inside = shmgen_enter(end, limit);
    bool whole;
    if (!inside && !shmgen_may_go_on(end))
        return SHMGEN_LOCK_TIMEOUT;
    whole = shmgen_is_whole(end, number, slot);
    if (whole) {
        memcpy(stamp, end->base + slot + offsetof(shmgen_slot, stamp_ns), sizeof *stamp);
        SHMGEN_COPY(into, end->base + slot + SHMGEN_SLOT_HEADER, size);
        /* Again behind the copy: a writer says what it is about to overwrite before it does. */
        __atomic_thread_fence(__ATOMIC_ACQUIRE);
        whole = shmgen_is_whole(end, number, slot);
    }
    if (inside)
        shmgen_leave(end);
    return whole ? SHMGEN_OK : SHMGEN_OVERWRITTEN;
}

/* Looks at a message that was read, or puts it right; NULL for one that can hold anything. */
typedef shmgen_status (*shmgen_receive)(void *message, shmgen_path *path);

/* Copies sample `number` and counts it as read, and those in between as missed. */
static inline shmgen_status shmgen_take(
    shmgen_subscriber *self, uint32_t number, void *into, size_t size, int64_t limit, shmgen_receive receive)
{
    shmgen_link *end = &self->end;
    uint64_t own[SHMGEN_SMALL / sizeof(uint64_t)];
    void *copy = size <= sizeof own ? (void *)own : into;
    uint64_t stamp = 0;
    uint32_t skipped;
    shmgen_status status = shmgen_copy(self, number, copy, size, limit, &stamp);
    if (status != SHMGEN_OK)
        return status;
    skipped = shmgen_steps(end, self->last, number) - 1;
    if (skipped != 0 && skipped < SHMGEN_ANEW) {
        self->missed += skipped;
        /* Outside of the lock: of two readers that add at once one may be lost, which a figure for people survives. */
        shmgen_store(end, SHMGEN_AT(missed), shmgen_load(end, SHMGEN_AT(missed)) + skipped);
    }
    self->last = number;
    if (receive != NULL) {
        shmgen_path_clear(&self->path);
        status = receive(copy, &self->path);
        if (status != SHMGEN_OK) {
            end->refused++;
            if (copy == into)
                memset(into, 0, size);
            return status;
        }
    }
    if (copy != into)
        memcpy(into, own, size);
    self->sequence = number;
    self->stamp = stamp;
    return SHMGEN_OK;
}

static inline shmgen_status shmgen_readable(shmgen_subscriber *self, size_t size)
{
    if (self->end.step != SHMGEN_STEP_READY)
        return shmgen_why(self->gone);
    if (shmgen_is_inherited(&self->end)) {
        shmgen_subscriber_close(self);
        return self->gone = SHMGEN_IN_FORKED_CHILD;
    }
    return size == self->end.type.size ? SHMGEN_OK : SHMGEN_SIZEOF_MISMATCH;
}

/* A writer was quicker each time: what a large copy has left is no sample. */
static inline shmgen_status shmgen_give_up(void *into, size_t size)
{
    if (size > SHMGEN_SMALL)
        memset(into, 0, size);
    return SHMGEN_OVERWRITTEN;
}

/* The newest sample. `size` is that of `into`, the message's; `limit` in ns for the lock, 0 = one try without a system
 * call.
 * SHMGEN_NOTHING_NEW: it has been read already. SHMGEN_LOCK_TIMEOUT: not now. SHMGEN_OVERWRITTEN: again and again, by a
 * writer that is quicker. SHMGEN_COUNT_EXCEEDED: it says of a sequence that it has more elements than its bound; it is
 * passed over and counted in `end.refused`. `into` is changed by SHMGEN_OK only, but for more than SHMGEN_SMALL bytes:
 * they may be 0 after the last two. */
static inline shmgen_status shmgen_subscriber_read(
    shmgen_subscriber *self, void *into, size_t size, int64_t limit, shmgen_receive receive)
{
    shmgen_status status = shmgen_readable(self, size);
    if (status != SHMGEN_OK)
        return status;
    for (int left = SHMGEN_TRIES; left > 0; left--) {
        uint32_t number = shmgen_load(&self->end, SHMGEN_AT(completed));
        if (number == 0 || number == self->last)
            return SHMGEN_NOTHING_NEW;
        status = shmgen_take(self, number, into, size, limit, receive);
        if (status != SHMGEN_OVERWRITTEN)
            return status;
    }
    return shmgen_give_up(into, size);
}

/* The oldest unread sample that is still there; as shmgen_subscriber_read() in all else. */
static inline shmgen_status shmgen_subscriber_read_next(
    shmgen_subscriber *self, void *into, size_t size, int64_t limit, shmgen_receive receive)
{
    shmgen_link *end = &self->end;
    shmgen_status status = shmgen_readable(self, size);
    if (status != SHMGEN_OK)
        return status;
    for (int left = SHMGEN_TRIES; left > 0; left--) {
        const uint32_t newest = shmgen_load(end, SHMGEN_AT(completed)), start = self->last;
        uint32_t unread, step;
        if (newest == 0 || newest == self->last)
            return SHMGEN_NOTHING_NEW;
        unread = shmgen_steps(end, start, newest);
        if (unread >= SHMGEN_ANEW) { /* the region was begun anew and counts from 1 again */
            self->last = newest - 1;
            continue;
        }
        for (step = unread >= end->slots ? unread - end->slots + 1 : 1; step <= unread; step++) {
            status = shmgen_take(self, shmgen_after(end, start, step), into, size, limit, receive);
            if (status != SHMGEN_OVERWRITTEN)
                return status;
        }
    }
    return shmgen_give_up(into, size);
}

/* Until the writer posts the event, or `completed` has left `newest` behind already; `ns` at most. */
static inline void shmgen_sleep(shmgen_subscriber *self, int64_t ns, uint32_t newest)
{
    shmgen_link *end = &self->end;
    if (end->event == NULL || shmgen_load(end, SHMGEN_AT(armed)) != 0) {
        /* There is no event, or another reader has it. If that died waiting, the next sample clears the word. */
        shmgen_pause(ns < SHMGEN_POLL_MS * SHMGEN_MS ? ns : SHMGEN_POLL_MS * SHMGEN_MS);
        return;
    }
    shmgen_store(end, SHMGEN_AT(armed), 1);
    shmgen_fence(false);
    if (shmgen_load(end, SHMGEN_AT(completed)) != newest || !shmgen_token(end->event, ns) ||
        shmgen_load(end, SHMGEN_AT(armed)) != 0)
        shmgen_store(end, SHMGEN_AT(armed), 0); /* left so, it would look like another reader's */
}

/* Waits `timeout` ns for an unread sample, and reads nothing: SHMGEN_OK or SHMGEN_NOTHING_NEW. The writer wakes one
 * waiting reader of a region, others look each millisecond. */
static inline shmgen_status shmgen_subscriber_ready(shmgen_subscriber *self, int64_t timeout)
{
    const int64_t end = shmgen_now() + timeout;
    shmgen_status status = SHMGEN_OK;
    if (self->end.step != SHMGEN_STEP_READY)
        return shmgen_why(self->gone);
    if (self->end.event == NULL) {
        self->end.since = shmgen_now();
        while ((status = shmgen_open_event(&self->end)) == SHMGEN_OPENING)
            shmgen_pause(SHMGEN_MS);
    }
    if (status != SHMGEN_OK)
        return status;
    for (;;) {
        const uint32_t newest = shmgen_load(&self->end, SHMGEN_AT(completed));
        int64_t left;
        if (newest != 0 && newest != self->last)
            return SHMGEN_OK;
        left = end - shmgen_now();
        if (left <= 0)
            return SHMGEN_NOTHING_NEW;
        shmgen_sleep(self, left < SHMGEN_WAKE_MS * SHMGEN_MS ? left : SHMGEN_WAKE_MS * SHMGEN_MS, newest);
    }
}

/* The newest sample as soon as there is a new one, or SHMGEN_NOTHING_NEW after `timeout` ns. */
static inline shmgen_status shmgen_subscriber_wait(
    shmgen_subscriber *self, void *into, size_t size, int64_t timeout, shmgen_receive receive)
{
    const int64_t end = shmgen_now() + timeout;
    for (;;) {
        int64_t left = end - shmgen_now();
        shmgen_status status = shmgen_subscriber_ready(self, left > 0 ? left : 0);
        if (status == SHMGEN_OK)
            status = shmgen_subscriber_read(self, into, size, self->end.limit, receive);
        if (status != SHMGEN_NOTHING_NEW && status != SHMGEN_LOCK_TIMEOUT && status != SHMGEN_OVERWRITTEN)
            return status;
        if (shmgen_now() >= end)
            return SHMGEN_NOTHING_NEW;
        if (status != SHMGEN_NOTHING_NEW) /* it is there, and cannot be had just now */
            shmgen_pause(SHMGEN_POLL_MS * SHMGEN_MS);
    }
}

/* What is there counts as read. */
static inline void shmgen_subscriber_skip(shmgen_subscriber *self)
{
    if (self->end.step == SHMGEN_STEP_READY)
        self->last = shmgen_load(&self->end, SHMGEN_AT(completed));
}

/* Whether the writer's heartbeat has stood still for `timeout` ns, as seen by calls of this; before the first the time
 * counts from the opening. Call it in each cycle. */
static inline bool shmgen_subscriber_is_stale(shmgen_subscriber *self, int64_t timeout)
{
    uint32_t beat;
    int64_t now = shmgen_now();
    if (self->end.step != SHMGEN_STEP_READY)
        return true;
    beat = shmgen_load(&self->end, SHMGEN_AT(heartbeat));
    if (beat != self->beat) {
        self->beat = beat;
        self->beat_since = now;
    }
    return now - self->beat_since >= timeout;
}

/* ns since the newest sample read was written, by the wall clock; -1 without one, or without its stamp. */
static inline int64_t shmgen_subscriber_age(const shmgen_subscriber *self)
{
    return self->stamp != 0 ? (int64_t)(shmgen_wall() - self->stamp) : -1;
}

#ifdef __cplusplus
}
#endif

#endif
