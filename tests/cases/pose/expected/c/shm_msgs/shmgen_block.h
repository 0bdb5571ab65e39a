/* A function block's end of a topic: opens and tries again, reads or writes once a cycle, never waits, and lets go of all
 * when the program is unloaded. The block itself keeps a number only, so that a value out of retained memory harms nothing.
 *
 * Made by shmgen; changes made here are lost.
 */
#ifndef SHMGEN_BLOCK_H
#define SHMGEN_BLOCK_H

#include "shmgen_publisher.h"
#include "shmgen_subscriber.h"

#include <stdlib.h>

#ifdef __cplusplus
extern "C" {
#endif

/* Ends that one program may have open at a time. */
#define SHMGEN_BLOCKS 4096
/* Errors below this number are in the inputs: to try again is in vain. */
#define SHMGEN_FIRST_TRIED_AGAIN 10

typedef struct shmgen_block {
    const void *owner; /* the function block's data */
    void *message;
    shmgen_publisher publisher;
    shmgen_subscriber subscriber;
    shmgen_type type;
    shmgen_options options;
    int64_t failed;      /* ns, when opening failed */
    shmgen_status error; /* why it is not open; stays until it is */
    shmgen_status unfit; /* why the newest sample was not taken, or not written */
    uint32_t writer;
    uint32_t opening;  /* 1: under way, 0: not begun or failed */
    uint32_t ready;    /* 1: open */
    uint32_t valid;    /* 1: a sample was read */
    uint32_t sequence; /* number of the sample written or read last */
    uint32_t misses;   /* of the ends before this one, as the next two */
    uint32_t missed;
    uint32_t refused;
    uint32_t place; /* in the table */
    uint32_t reserved;
    char topic[256];
} shmgen_block;

static shmgen_block *shmgen_blocks[SHMGEN_BLOCKS];
/* 1: inside a call, or unloaded. */
static uint8_t shmgen_busy[SHMGEN_BLOCKS];
static uint8_t shmgen_unloaded;

static inline void shmgen_block_rest(shmgen_block *self)
{
    self->misses += self->publisher.end.misses + self->subscriber.end.misses;
    self->refused += self->subscriber.end.refused;
    self->missed += self->subscriber.missed;
    shmgen_publisher_close(&self->publisher);
    shmgen_subscriber_close(&self->subscriber);
    self->publisher.end.misses = self->subscriber.end.misses = 0;
    self->subscriber.end.refused = self->subscriber.missed = 0;
    self->ready = self->opening = 0;
}

static inline void shmgen_block_fail(shmgen_block *self, shmgen_status error)
{
    shmgen_block_rest(self);
    self->error = error;
    self->failed = shmgen_now();
}

/* The settings are taken over; what they say is opened step by step. */
static inline void shmgen_block_start(shmgen_block *self)
{
    shmgen_status status =
        self->writer != 0 ? shmgen_publisher_start(&self->publisher, self->topic, &self->type, &self->options)
                          : shmgen_subscriber_start(&self->subscriber, self->topic, &self->type, &self->options);
    self->opening = 1;
    if (status != SHMGEN_OPENING)
        shmgen_block_fail(self, status);
}

/* Whether it is open; if not, one step towards it. */
static inline bool shmgen_block_is_open(shmgen_block *self)
{
    shmgen_status status;
    if (self->ready != 0)
        return true;
    if (self->opening == 0) {
        if (self->error < SHMGEN_FIRST_TRIED_AGAIN || shmgen_now() - self->failed < SHMGEN_RETRY_MS * SHMGEN_MS)
            return false;
        shmgen_block_start(self);
        if (self->opening == 0)
            return false;
    }
    status = self->writer != 0 ? shmgen_publisher_step(&self->publisher) : shmgen_subscriber_step(&self->subscriber);
    if (status == SHMGEN_OPENING)
        return false;
    if (status != SHMGEN_OK) {
        shmgen_block_fail(self, status == SHMGEN_CLAIM_LOST ? SHMGEN_WRITER_IN_USE : status);
        return false;
    }
    self->error = SHMGEN_OK;
    self->ready = 1;
    return true;
}

/* Closes it and frees its place. */
static inline void shmgen_block_close(shmgen_block *self)
{
    const uint32_t place = self->place;
    shmgen_block_rest(self);
    free(self->message);
    free(self);
    __atomic_store_n(&shmgen_blocks[place], (shmgen_block *)NULL, __ATOMIC_RELEASE);
}

/* Nothing is left mapped when the program is unloaded. A thread that is inside a call still keeps its end: the process
 * is about to end then. */
__attribute__((destructor, unused)) static void shmgen_unload(void)
{
    __atomic_store_n(&shmgen_unloaded, (uint8_t)1, __ATOMIC_SEQ_CST);
    for (uint32_t place = 0; place < SHMGEN_BLOCKS; place++)
        if (__atomic_exchange_n(&shmgen_busy[place], (uint8_t)1, __ATOMIC_SEQ_CST) == 0 && shmgen_blocks[place] != NULL)
            shmgen_block_close(shmgen_blocks[place]);
}

/* The end with that number, if it is this owner's: between this and shmgen_block_leave() it is held. NULL: there is none,
 * or it has just been closed because the block is not enabled; the number is then 0. */
static inline shmgen_block *shmgen_block_enter(uint32_t *number, const void *owner, bool enabled)
{
    const uint32_t place = *number - 1;
    shmgen_block *self;
    if (*number == 0 || *number > SHMGEN_BLOCKS)
        return NULL;
    if (__atomic_exchange_n(&shmgen_busy[place], (uint8_t)1, __ATOMIC_ACQUIRE) != 0)
        return NULL;
    self = __atomic_load_n(&shmgen_blocks[place], __ATOMIC_ACQUIRE);
    if (self != NULL && self->owner == owner && enabled)
        return self;
    if (self != NULL && self->owner == owner)
        shmgen_block_close(self);
    *number = 0;
    __atomic_store_n(&shmgen_busy[place], (uint8_t)0, __ATOMIC_RELEASE);
    return NULL;
}

/* A new end, held as by shmgen_block_enter(). NULL: there is no room. */
static inline shmgen_block *shmgen_block_open(uint32_t *number, const void *owner, const shmgen_type *type, bool writer,
    const char *topic, size_t length, uint32_t depth)
{
    shmgen_block *self = NULL;
    void *message = NULL;
    if (__atomic_load_n(&shmgen_unloaded, __ATOMIC_SEQ_CST) == 0) {
        self = (shmgen_block *)calloc(1, sizeof *self);
        message = calloc(1, type->size);
    }
    for (uint32_t place = 0; self != NULL && message != NULL && place < SHMGEN_BLOCKS; place++) {
        if (shmgen_blocks[place] != NULL ||
            __atomic_exchange_n(&shmgen_busy[place], (uint8_t)1, __ATOMIC_ACQUIRE) != 0)
            continue;
        if (shmgen_blocks[place] != NULL) {
            __atomic_store_n(&shmgen_busy[place], (uint8_t)0, __ATOMIC_RELEASE);
            continue;
        }
        if (length >= sizeof self->topic)
            length = sizeof self->topic - 1;
        memcpy(self->topic, topic, length);
        self->owner = owner;
        self->message = message;
        self->type = *type;
        self->writer = writer ? 1 : 0;
        self->place = place;
        self->options.depth = depth;
        self->publisher.gone = self->subscriber.gone = SHMGEN_CLOSED;
        if (depth == 0)
            shmgen_block_fail(self, SHMGEN_DEPTH_INVALID);
        else
            shmgen_block_start(self);
        __atomic_store_n(&shmgen_blocks[place], self, __ATOMIC_RELEASE);
        *number = place + 1;
        return self;
    }
    free(message);
    free(self);
    return NULL;
}

static inline void shmgen_block_leave(const shmgen_block *self)
{
    if (self != NULL)
        __atomic_store_n(&shmgen_busy[self->place], (uint8_t)0, __ATOMIC_RELEASE);
}

/* A publisher's cycle: writes what is in `message`, unless it is not to be sent or does not fit; the heartbeat beats in
 * any case. */
static inline bool shmgen_block_write(shmgen_block *self, bool send, shmgen_status fits)
{
    shmgen_status status = SHMGEN_LOCK_TIMEOUT;
    if (!shmgen_block_is_open(self))
        return false;
    self->unfit = send ? fits : SHMGEN_OK;
    if (send && fits == SHMGEN_OK)
        status = shmgen_publisher_write(&self->publisher, self->message, self->type.size, 0);
    if (status == SHMGEN_OK) {
        self->sequence = self->publisher.sequence;
        return true;
    }
    if (status == SHMGEN_LOCK_TIMEOUT)
        status = shmgen_publisher_heartbeat(&self->publisher);
    if (status != SHMGEN_OK)
        shmgen_block_fail(self, status == SHMGEN_CLAIM_LOST ? SHMGEN_WRITER_IN_USE : status);
    return false;
}

/* A subscriber's cycle. True: there is a new sample in `message`. */
static inline bool shmgen_block_read(shmgen_block *self, bool newest, shmgen_receive receive)
{
    shmgen_status status;
    if (!shmgen_block_is_open(self))
        return false;
    status = newest ? shmgen_subscriber_read(&self->subscriber, self->message, self->type.size, 0, receive)
                    : shmgen_subscriber_read_next(&self->subscriber, self->message, self->type.size, 0, receive);
    if (status == SHMGEN_COUNT_EXCEEDED || status == SHMGEN_OK)
        self->unfit = status;
    if (status == SHMGEN_OK)
        self->sequence = self->subscriber.sequence;
    return status == SHMGEN_OK;
}

/* What the block says of it: eErrorID. `enabled` without an end: there was no room for one. */
static inline uint32_t shmgen_block_error(const shmgen_block *self, bool enabled)
{
    if (self == NULL)
        return enabled && shmgen_unloaded == 0 ? (uint32_t)SHMGEN_REGION_NO_MEMORY : 0;
    return (uint32_t)(self->error != SHMGEN_OK ? self->error : self->unfit);
}

static inline bool shmgen_block_is_busy(const shmgen_block *self)
{
    return self != NULL && self->ready == 0 && self->error == SHMGEN_OK;
}

/* Whether Msg holds a sample received since the block was enabled. */
static inline bool shmgen_block_is_valid(shmgen_block *self, bool fresh)
{
    if (self == NULL)
        return false;
    self->valid = shmgen_block_error(self, true) == 0 && (self->valid != 0 || fresh) ? 1 : 0;
    return self->valid != 0;
}

static inline bool shmgen_block_is_stale(shmgen_block *self, int64_t timeout)
{
    return self != NULL && self->ready != 0 && shmgen_subscriber_is_stale(&self->subscriber, timeout);
}

static inline uint32_t shmgen_block_misses(const shmgen_block *self)
{
    return self->misses + self->publisher.end.misses + self->subscriber.end.misses;
}

static inline uint32_t shmgen_block_missed(const shmgen_block *self)
{
    return self->missed + self->subscriber.missed;
}

static inline uint32_t shmgen_block_refused(const shmgen_block *self)
{
    return self->refused + self->subscriber.end.refused;
}

/* A text of the program's, up to its NUL, into so many characters and a NUL. One that is longer is left without its end,
 * by which the check of the message finds it. */
static inline void shmgen_text_out(char *to, size_t capacity, const void *from, size_t length)
{
    const void *end = memchr(from, 0, length);
    if (end != NULL)
        length = (size_t)((const char *)end - (const char *)from);
    if (length > capacity)
        length = capacity + 1;
    memcpy(to, from, length);
    memset(to + length, 0, capacity + 1 - length);
}

/* A text of a message into the program's, which has `room` bytes; how many characters it has. */
static inline size_t shmgen_text_in(void *to, size_t room, const char *from)
{
    size_t length = strlen(from);
    if (length > room)
        length = room;
    memcpy(to, from, length);
    if (length < room)
        memset((char *)to + length, 0, room - length);
    return length;
}

#ifdef __cplusplus
}
#endif

#endif
