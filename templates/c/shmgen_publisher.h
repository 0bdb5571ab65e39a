/* The one writer of a topic: claims it, writes samples, wakes a reader (docs/protocol.md, "Writing", "Second writer").
 *
 * Made by shmgen; changes made here are lost.
 */
#ifndef SHMGEN_PUBLISHER_H
#define SHMGEN_PUBLISHER_H

#include "shmgen_open.h"

#ifdef __cplusplus
extern "C" {
#endif

/* For one thread at a time. `end.misses` counts locks not free in time, `end.refused` messages that did not fit. */
typedef struct shmgen_publisher {
    shmgen_link end;
    shmgen_status gone; /* what calls say once it is not open */
    uint32_t sequence;  /* number of the newest sample, 0 = none yet */
    uint32_t number;    /* of the sample between begin and complete */
    uint32_t beat;      /* heartbeat as last written, or as seen while a PLC is watched */
    uint32_t jump;      /* 1: a writer before may only stand still, and its numbers are left to it */
    uint32_t inside;    /* 1: in the lock */
    uint32_t unstamped;
    uint32_t reserved;
    shmgen_path path; /* the field that did not fit */
} shmgen_publisher;

/* Lets go of the topic, which others may claim then. The region stays. Does nothing the second time. */
static inline void shmgen_publisher_close(shmgen_publisher *self)
{
    if (self->inside != 0 && !shmgen_is_inherited(&self->end))
        shmgen_leave(&self->end);
    self->inside = 0;
    shmgen_link_close(&self->end);
    self->gone = SHMGEN_CLOSED;
}

/* Begins to open a topic without waiting: call shmgen_publisher_step() in each cycle until it says SHMGEN_OK. `options`
 * may be NULL. */
static inline shmgen_status shmgen_publisher_start(
    shmgen_publisher *self, const char *topic, const shmgen_type *type, const shmgen_options *options)
{
    memset(self, 0, sizeof *self);
    shmgen_path_clear(&self->path);
    self->gone = shmgen_link_start(&self->end, topic, type, options);
    self->unstamped = options != NULL ? options->unstamped : 0;
    if (self->gone == SHMGEN_OK)
        self->gone = SHMGEN_OPENING;
    return self->gone;
}

static inline shmgen_status shmgen_claimed(shmgen_publisher *self)
{
    shmgen_link *end = &self->end;
    self->sequence = shmgen_load(end, SHMGEN_AT(completed));
    if (self->jump != 0)
        self->sequence = shmgen_after(end, self->sequence, end->slots);
    self->beat = shmgen_load(end, SHMGEN_AT(heartbeat));
    end->step = SHMGEN_STEP_READY;
    return SHMGEN_OK;
}

/* Puts this process's name there. `looked`: when it was seen that nobody else is the writer; if we ourselves stood
 * still since, somebody may have begun meanwhile. */
static inline shmgen_status shmgen_put_name(shmgen_publisher *self, int64_t looked)
{
    shmgen_link *end = &self->end;
    shmgen_store(end, SHMGEN_AT(writer), end->pid);
    if (shmgen_now() - looked > SHMGEN_CONFIRM_MS * SHMGEN_MS / 2)
        self->jump = 1;
    return self->jump != 0 ? shmgen_go(end, SHMGEN_STEP_CONFIRM) : shmgen_claimed(self);
}

/* A record lock keeps other processes out. A PLC knows none: it is watched for a second, then this process puts its
 * name over the PLC's, waits, and looks whether it still stands. */
static inline shmgen_status shmgen_claim(shmgen_publisher *self)
{
    shmgen_link *end = &self->end;
    int64_t looked = shmgen_now();
    uint32_t writer = shmgen_load(end, SHMGEN_AT(writer));
    if (end->step == SHMGEN_STEP_CLAIM) {
        shmgen_status status = shmgen_open_event(end);
        if (status != SHMGEN_OK)
            return status;
        if (!shmgen_byte(end, SHMGEN_WRITER_LOCK, F_WRLCK))
            return SHMGEN_WRITER_IN_USE;
        if (writer != SHMGEN_PLC)
            return shmgen_put_name(self, looked);
        self->beat = shmgen_load(end, SHMGEN_AT(heartbeat));
        return shmgen_go(end, SHMGEN_STEP_WATCH);
    }
    if (end->step == SHMGEN_STEP_CONFIRM) {
        if (shmgen_elapsed(end) < SHMGEN_CONFIRM_MS * SHMGEN_MS)
            return SHMGEN_OPENING;
        return writer == end->pid ? shmgen_claimed(self) : SHMGEN_WRITER_IN_USE;
    }
    if (writer == 0)
        return shmgen_put_name(self, looked);
    if (writer != SHMGEN_PLC || shmgen_load(end, SHMGEN_AT(heartbeat)) != self->beat)
        return SHMGEN_WRITER_IN_USE;
    if (shmgen_elapsed(end) < SHMGEN_CLAIM_MS * SHMGEN_MS)
        return SHMGEN_OPENING;
    self->jump = 1;
    return shmgen_put_name(self, looked);
}

/* One step of opening, which does not wait: SHMGEN_OPENING until it is open, SHMGEN_OK then, or why it cannot be. */
static inline shmgen_status shmgen_publisher_step(shmgen_publisher *self)
{
    shmgen_status status;
    if (self->end.step == SHMGEN_STEP_READY)
        return SHMGEN_OK;
    if (self->gone != SHMGEN_OPENING)
        return shmgen_why(self->gone);
    if (self->end.step < SHMGEN_STEP_CLAIM) {
        status = shmgen_link_step(&self->end);
        if (status == SHMGEN_OK)
            status = SHMGEN_OPENING;
    } else {
        status = shmgen_claim(self);
    }
    if (status != SHMGEN_OK && status != SHMGEN_OPENING)
        shmgen_link_close(&self->end);
    self->gone = status;
    return status;
}

/* Opens the region or makes it, and claims it, which takes a second where a PLC was the writer before. */
static inline shmgen_status shmgen_publisher_open(
    shmgen_publisher *self, const char *topic, const shmgen_type *type, const shmgen_options *options)
{
    shmgen_status status = shmgen_publisher_start(self, topic, type, options);
    while (status == SHMGEN_OPENING) {
        uint32_t step = self->end.step;
        status = shmgen_publisher_step(self);
        if (status == SHMGEN_OPENING && self->end.step == step)
            shmgen_pause(SHMGEN_MS);
    }
    return status;
}

/* In a forked child: lets go, and of nothing that is the parent's. */
static inline shmgen_status shmgen_publisher_disown(shmgen_publisher *self)
{
    shmgen_publisher_close(self);
    return self->gone = SHMGEN_IN_FORKED_CHILD;
}

/* Leaves the topic to the writer who has claimed it: this one stood still for a second, or seemed to. */
static inline shmgen_status shmgen_lose(shmgen_publisher *self)
{
    if (self->inside != 0)
        shmgen_leave(&self->end);
    self->inside = 0;
    shmgen_link_close(&self->end);
    return self->gone = SHMGEN_CLAIM_LOST;
}

/* Whether the topic is this publisher's still. */
static inline shmgen_status shmgen_publisher_assure(shmgen_publisher *self)
{
    if (self->end.step != SHMGEN_STEP_READY)
        return shmgen_why(self->gone);
    if (shmgen_is_inherited(&self->end))
        return shmgen_publisher_disown(self);
    return shmgen_load(&self->end, SHMGEN_AT(writer)) == self->end.pid ? SHMGEN_OK : shmgen_lose(self);
}

/* Tells readers that the writer lives, without a sample. */
static inline shmgen_status shmgen_publisher_heartbeat(shmgen_publisher *self)
{
    shmgen_status status = shmgen_publisher_assure(self);
    if (status == SHMGEN_OK)
        shmgen_store(&self->end, SHMGEN_AT(heartbeat), ++self->beat);
    return status;
}

/* Begins the next sample: *payload is where its bytes go, which are then the region's own, with what an older sample
 * has left there. Behind it comes complete or cancel. `limit` is in ns, 0 = one try, without a system call.
 * SHMGEN_LOCK_TIMEOUT: the lock was not free, on a machine that needs it. */
static inline shmgen_status shmgen_publisher_begin(shmgen_publisher *self, int64_t limit, void **payload)
{
    shmgen_link *end = &self->end;
    size_t slot;
    uint64_t stamp;
    if (end->step != SHMGEN_STEP_READY)
        return shmgen_why(self->gone);
    if (shmgen_is_inherited(end))
        return shmgen_publisher_disown(self);
    self->number = shmgen_after(end, self->sequence, 1);
    stamp = self->unstamped != 0 ? 0 : shmgen_wall();
    self->inside = shmgen_enter(end, limit);
    if (self->inside == 0 && !shmgen_may_go_on(end))
        return SHMGEN_LOCK_TIMEOUT;
    if (shmgen_load(end, SHMGEN_AT(writer)) != end->pid)
        return shmgen_lose(self);
    shmgen_store(end, SHMGEN_AT(heartbeat), ++self->beat);
    shmgen_store(end, SHMGEN_AT(begun), self->number);
    if (end->type.size < SHMGEN_STREAMED)
        __atomic_thread_fence(__ATOMIC_RELEASE);
    else
        __atomic_thread_fence(__ATOMIC_SEQ_CST);
    slot = shmgen_slot_of(end, self->number);
    memcpy(end->base + slot + offsetof(shmgen_slot, stamp_ns), &stamp, sizeof stamp);
    shmgen_store(end, slot + offsetof(shmgen_slot, number), self->number);
    *payload = end->base + slot + SHMGEN_SLOT_HEADER;
    return SHMGEN_OK;
}

/* Gives up what begin began; its number is used for the next. */
static inline void shmgen_publisher_cancel(shmgen_publisher *self)
{
    if (self->inside != 0)
        shmgen_leave(&self->end);
    self->inside = 0;
}

/* Completes the sample, comes out of the lock, and wakes a reader that waits. SHMGEN_CLAIM_LOST: another writer has
 * taken the topic over since begin, and what was written is void. */
static inline shmgen_status shmgen_publisher_complete(shmgen_publisher *self)
{
    shmgen_link *end = &self->end;
    const bool posted = self->inside != 0;
    if (end->step != SHMGEN_STEP_READY)
        return shmgen_why(self->gone);
    if (shmgen_load(end, SHMGEN_AT(writer)) != end->pid) {
        shmgen_store(end, shmgen_slot_of(end, self->number) + offsetof(shmgen_slot, number), 0);
        return shmgen_lose(self);
    }
    self->sequence = self->number;
    shmgen_store(end, SHMGEN_AT(completed), self->number);
    if (posted)
        shmgen_leave(end);
    self->inside = 0;
    shmgen_fence(posted);
    if (shmgen_load(end, SHMGEN_AT(armed)) != 0) {
        shmgen_store(end, SHMGEN_AT(armed), 0);
        if (end->event != NULL)
            shmgen_post(end->event);
    }
    return SHMGEN_OK;
}

/* Writes a message of `size` bytes, those of its type; nothing looks into it. */
static inline shmgen_status shmgen_publisher_write(
    shmgen_publisher *self, const void *message, size_t size, int64_t limit)
{
    void *payload = NULL;
    shmgen_status status;
    if (self->end.step == SHMGEN_STEP_READY && size != self->end.type.size)
        return SHMGEN_SIZEOF_MISMATCH;
    status = shmgen_publisher_begin(self, limit, &payload);
    if (status != SHMGEN_OK)
        return status;
    SHMGEN_COPY(payload, message, size);
    return shmgen_publisher_complete(self);
}

#ifdef __cplusplus
}
#endif

#endif
