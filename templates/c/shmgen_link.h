/* One end of a region: its words, its sizes, its clock. What publishers and subscribers share.
 *
 * Made by shmgen; changes made here are lost.
 */
#ifndef SHMGEN_LINK_H
#define SHMGEN_LINK_H

#include "shmgen_status.h"

#include <errno.h>
#include <fcntl.h>
#include <semaphore.h>
#include <signal.h>
#include <stdbool.h>
#include <sys/mman.h>
#include <sys/stat.h>
#include <sys/types.h>
#include <time.h>
#include <unistd.h>

#if !defined(O_CLOEXEC) || !defined(O_NOFOLLOW) || !defined(CLOCK_MONOTONIC)
#error "shmgen needs POSIX 2008: include its headers before others, or compile with -std=gnu11 or -D_GNU_SOURCE"
#endif

#ifdef __cplusplus
extern "C" {
#endif

/* Whether loads and stores of this machine keep their order, so that the slots alone carry integrity. */
#ifndef SHMGEN_KEEPS_ORDER
#if defined(__x86_64__) || defined(__i386__)
#define SHMGEN_KEEPS_ORDER 1
#else
#define SHMGEN_KEEPS_ORDER 0
#endif
#endif

/* What copies a payload to its slot and from it. */
#ifndef SHMGEN_COPY
#define SHMGEN_COPY memcpy
#endif

/* From so many bytes on, memcpy may use stores that pass earlier ones even where stores keep their order. */
#define SHMGEN_STREAMED 65536
/* How often a sample overwritten while it was copied is given up for a newer one in one call. */
#define SHMGEN_TRIES 8
/* How often a file that vanishes while it is opened is opened anew. */
#define SHMGEN_ATTEMPTS 10
#define SHMGEN_MS INT64_C(1000000)

/* A message as its region knows it. Mode 0 and group NULL: shmgen.toml says nothing of them. */
typedef struct shmgen_type {
    const char *name;
    const char *group;
    uint64_t digest;
    uint32_t size;
    uint32_t mode;
    uint32_t sequence; /* 1: sync = "sequence", no lock */
    uint32_t reserved;
} shmgen_type;

/* All 0 is what is usual. */
typedef struct shmgen_options {
    const char *group;  /* of the files, by name or number; NULL: what shmgen.toml says, if anything */
    uint32_t depth;     /* samples a slow reader can still fetch, the same on both sides; 0: 1 */
    uint32_t mode;      /* of the files, as 0660; 0: what shmgen.toml says, or 0660 for those made here */
    uint32_t lock_us;   /* the longest a call waits for the lock, 1000000 at most; 0: SHMGEN_LOCK_MS */
    uint32_t unstamped; /* 1: samples carry no time, which saves a look at the clock */
} shmgen_options;

/* Where opening is; each step is taken without waiting. */
typedef enum shmgen_step {
    SHMGEN_STEP_CLOSED,
    SHMGEN_STEP_FILE,
    SHMGEN_STEP_ADMIT,
    SHMGEN_STEP_HEADER,
    SHMGEN_STEP_SETTLE,
    SHMGEN_STEP_LOCK,
    SHMGEN_STEP_CLAIM,
    SHMGEN_STEP_WATCH,
    SHMGEN_STEP_CONFIRM,
    SHMGEN_STEP_READY
} shmgen_step;

typedef struct shmgen_link {
    unsigned char *base; /* the region */
    unsigned char *mine; /* a page whose first byte is 1, and 0 in a forked child; NULL: not to be had */
    sem_t *lock;         /* NULL: none */
    sem_t *event;        /* NULL: not opened, or none */
    shmgen_type type;
    uint64_t size;  /* bytes of the region */
    int64_t limit;  /* ns to wait for the lock */
    int64_t since;  /* ns, start of the present step */
    int64_t stood;  /* ns, since when the stay inside the lock that is known has lasted */
    int64_t group;  /* wanted of the files, -1: none in particular */
    uint32_t mode;  /* the same, 0: none in particular */
    uint32_t step;  /* a shmgen_step */
    uint32_t slots;
    uint32_t slot_size;
    uint32_t pid;         /* of the process that opened it; it is the only one that may use it */
    uint32_t seen_holder; /* the stay that is known */
    uint32_t seen_count;
    uint32_t seen;     /* 1: one is known, 2: and has been waited for */
    uint32_t misses;   /* how often the lock was not free in time */
    uint32_t refused;  /* messages that did not fit, or said so of a sequence */
    uint32_t attempts;
    int file;
    char name[256]; /* "/robot.pose" */
} shmgen_link;

#define SHMGEN_AT(word) offsetof(shmgen_region, word)

static inline uint32_t shmgen_load(const shmgen_link *link, size_t word)
{
    return __atomic_load_n((const uint32_t *)(const void *)(link->base + word), __ATOMIC_ACQUIRE);
}

static inline void shmgen_store(const shmgen_link *link, size_t word, uint32_t value)
{
    __atomic_store_n((uint32_t *)(void *)(link->base + word), value, __ATOMIC_RELEASE);
}

/* Where the slot of sample `number` begins. */
static inline size_t shmgen_slot_of(const shmgen_link *link, uint32_t number)
{
    return SHMGEN_HEADER_SIZE + (size_t)(number & (link->slots - 1)) * link->slot_size;
}

/* The number of the sample so many steps later: after SHMGEN_LAST comes `slots`. */
static inline uint32_t shmgen_after(const shmgen_link *link, uint32_t number, uint32_t steps)
{
    uint32_t later = number + steps;
    return later < number ? later + link->slots : later;
}

/* How many samples later `newer` was written than `older`. */
static inline uint32_t shmgen_steps(const shmgen_link *link, uint32_t older, uint32_t newer)
{
    return newer >= older ? newer - older : newer - older - link->slots;
}

/* ns by the clock that nobody sets. */
static inline int64_t shmgen_now(void)
{
    struct timespec now;
    clock_gettime(CLOCK_MONOTONIC, &now);
    return (int64_t)now.tv_sec * INT64_C(1000000000) + (int64_t)now.tv_nsec;
}

/* ns since 1970. */
static inline uint64_t shmgen_wall(void)
{
    struct timespec now;
    clock_gettime(CLOCK_REALTIME, &now);
    return (uint64_t)now.tv_sec * UINT64_C(1000000000) + (uint64_t)now.tv_nsec;
}

static inline void shmgen_pause(int64_t ns)
{
    struct timespec left;
    left.tv_sec = (time_t)(ns / INT64_C(1000000000));
    left.tv_nsec = (long)(ns % INT64_C(1000000000));
    nanosleep(&left, NULL);
}

/* ns since the present step of opening began. */
static inline int64_t shmgen_elapsed(const shmgen_link *link)
{
    return shmgen_now() - link->since;
}

/* What calls say of an end that is not open. */
static inline shmgen_status shmgen_why(shmgen_status gone)
{
    return gone == SHMGEN_OK ? SHMGEN_CLOSED : gone;
}

/* What no forked child may use: the parent's name stands in the region, and the claim is the parent's. */
static inline bool shmgen_is_inherited(const shmgen_link *link)
{
    return link->mine != NULL && *link->mine == 0;
}

static inline shmgen_status shmgen_go(shmgen_link *link, shmgen_step step)
{
    link->step = (uint32_t)step;
    link->since = shmgen_now();
    return SHMGEN_OPENING;
}

/* A record lock of the open-file kind, which goes with the descriptor, also by SIGKILL: kind is F_WRLCK or F_UNLCK. */
static inline bool shmgen_byte(const shmgen_link *link, off_t byte, short kind)
{
#ifdef F_OFD_SETLK
    const int command = F_OFD_SETLK;
#else
    const int command = 37; /* Linux's number, which libraries show with _GNU_SOURCE only */
#endif
    struct flock asked;
    memset(&asked, 0, sizeof asked);
    asked.l_type = kind;
    asked.l_whence = SEEK_SET;
    asked.l_start = byte;
    asked.l_len = 1;
    return fcntl(link->file, command, &asked) == 0;
}

/* Whether somebody else holds that record lock. */
static inline bool shmgen_byte_is_locked(const shmgen_link *link, off_t byte)
{
#ifdef F_OFD_GETLK
    const int command = F_OFD_GETLK;
#else
    const int command = 36;
#endif
    struct flock asked;
    memset(&asked, 0, sizeof asked);
    asked.l_type = F_WRLCK;
    asked.l_whence = SEEK_SET;
    asked.l_start = byte;
    asked.l_len = 1;
    return fcntl(link->file, command, &asked) == 0 && asked.l_type != F_UNLCK;
}

#ifdef __cplusplus
}
#endif

#endif
