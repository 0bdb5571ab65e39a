/* How every call ends, as a number and as a text, and the path of a field that does not fit.
 *
 * Made by shmgen; changes made here are lost.
 */
#ifndef SHMGEN_STATUS_H
#define SHMGEN_STATUS_H

#include "shmgen.h"

#include <string.h>

#ifdef __cplusplus
extern "C" {
#endif

/* The numbers up to 52 are those of E_ShmError on a PLC where they mean the same. */
typedef enum shmgen_status {
    SHMGEN_OK = 0,
    SHMGEN_TOPIC_EMPTY = 1,
    SHMGEN_TOPIC_INVALID = 2,
    SHMGEN_TOPIC_TOO_LONG = 3,
    SHMGEN_DEPTH_INVALID = 4,
    SHMGEN_SIZEOF_MISMATCH = 5,
    SHMGEN_LIMIT_INVALID = 6,
    SHMGEN_GROUP_UNKNOWN = 7,
    SHMGEN_NEEDS_LOCK = 8,
    SHMGEN_REGION_NO_ACCESS = 10,
    SHMGEN_REGION_NO_MEMORY = 11,
    SHMGEN_REGION_SIZE_MISMATCH = 12,
    SHMGEN_REGION_OPEN_FAILED = 13,
    SHMGEN_RESTLESS = 15,
    SHMGEN_STRANGER = 16,
    SHMGEN_NOT_A_REGION = 20,
    SHMGEN_ABI_MISMATCH = 21,
    SHMGEN_DIGEST_MISMATCH = 22,
    SHMGEN_PAYLOAD_MISMATCH = 23,
    SHMGEN_DEPTH_MISMATCH = 24,
    SHMGEN_SEMAPHORE_NO_ACCESS = 30,
    SHMGEN_SEMAPHORE_FAILED = 31,
    SHMGEN_LOCK_TIMEOUT = 33,
    SHMGEN_WRITER_IN_USE = 40,
    SHMGEN_CLAIM_LOST = 41,
    SHMGEN_CALL_TIMEOUT = 50,
    SHMGEN_CALL_FAILED = 51,
    SHMGEN_COUNT_EXCEEDED = 52,
    SHMGEN_TEXT_TOO_LONG = 53,
    SHMGEN_NO_SERVER = 54,
    SHMGEN_CALL_OVER = 55,
    SHMGEN_NOTHING_NEW = 100,
    SHMGEN_OVERWRITTEN = 101,
    SHMGEN_OPENING = 102,
    SHMGEN_CLOSED = 103,
    SHMGEN_IN_FORKED_CHILD = 104
} shmgen_status;

static inline const char *shmgen_status_text(shmgen_status status)
{
    switch (status) {
    case SHMGEN_OK: return "done";
    case SHMGEN_TOPIC_EMPTY: return "the topic is empty";
    case SHMGEN_TOPIC_INVALID: return "the topic is not made of letters, digits and _ between single slashes";
    case SHMGEN_TOPIC_TOO_LONG: return "the topic is longer than a file name may be";
    case SHMGEN_DEPTH_INVALID: return "the depth is not in 1 to 65535";
    case SHMGEN_SIZEOF_MISMATCH: return "the buffer is not of the message's size";
    case SHMGEN_LIMIT_INVALID: return "the time limit of the lock is more than a second";
    case SHMGEN_GROUP_UNKNOWN: return "there is no such group here";
    case SHMGEN_NEEDS_LOCK: return "sync = \"sequence\" needs a machine that keeps the order of loads and stores";
    case SHMGEN_REGION_NO_ACCESS: return "this user may not open or make the region: see docs/deploy.md";
    case SHMGEN_REGION_NO_MEMORY: return "no room in /dev/shm";
    case SHMGEN_REGION_SIZE_MISMATCH: return "the region has another size: another depth or message";
    case SHMGEN_REGION_OPEN_FAILED: return "the region cannot be opened, or is no regular file";
    case SHMGEN_RESTLESS: return "something keeps removing the region";
    case SHMGEN_STRANGER: return "a stranger could write the region, which is not used: see docs/deploy.md";
    case SHMGEN_NOT_A_REGION: return "the shared memory of this name was not made by shmgen";
    case SHMGEN_ABI_MISMATCH: return "the region was made by another generation of shmgen";
    case SHMGEN_DIGEST_MISMATCH: return "the region holds another message, or another version: generate both sides";
    case SHMGEN_PAYLOAD_MISMATCH: return "the same digest with another size: the header is damaged";
    case SHMGEN_DEPTH_MISMATCH: return "the depth differs from the other side's";
    case SHMGEN_SEMAPHORE_NO_ACCESS: return "this user may not open the semaphore: see docs/deploy.md";
    case SHMGEN_SEMAPHORE_FAILED: return "there is no semaphore of this machine's C library";
    case SHMGEN_LOCK_TIMEOUT: return "the lock was not free in time";
    case SHMGEN_WRITER_IN_USE: return "somebody else publishes already: one writer a topic";
    case SHMGEN_CLAIM_LOST: return "another writer has taken the topic over";
    case SHMGEN_CALL_TIMEOUT: return "no answer in time";
    case SHMGEN_CALL_FAILED: return "the server answered that it could not do it";
    case SHMGEN_COUNT_EXCEEDED: return "more elements than the bound";
    case SHMGEN_TEXT_TOO_LONG: return "a text that does not fit: longer than its capacity, or with a NUL inside";
    case SHMGEN_NO_SERVER: return "nobody serves; nothing was sent";
    case SHMGEN_CALL_OVER: return "nobody waits for this answer any more";
    case SHMGEN_NOTHING_NEW: return "no sample that has not been read";
    case SHMGEN_OVERWRITTEN: return "the sample was overwritten while it was copied";
    case SHMGEN_OPENING: return "not open yet";
    case SHMGEN_CLOSED: return "not open";
    case SHMGEN_IN_FORKED_CHILD: return "it belongs to the process from which this one was forked: open one here";
    }
    return "no status of shmgen";
}

/* Where a value does not fit, `points[3].label`; written from its end, so that it begins at text + at. */
typedef struct shmgen_path {
    char text[252];
    uint32_t at;
} shmgen_path;

static inline void shmgen_path_clear(shmgen_path *path)
{
    path->at = sizeof path->text - 1;
    path->text[path->at] = 0;
}

static inline const char *shmgen_path_text(const shmgen_path *path)
{
    return path->at < sizeof path->text ? path->text + path->at : "";
}

/* What does not fit in front is left out. */
static inline void shmgen_path_put(shmgen_path *path, const char *name)
{
    size_t length = strlen(name);
    if (path->at < sizeof path->text && length <= path->at) {
        path->at -= (uint32_t)length;
        memcpy(path->text + path->at, name, length);
    }
}

static inline void shmgen_path_index(shmgen_path *path, uint32_t index)
{
    char digits[13];
    size_t at = sizeof digits - 1;
    digits[at] = 0;
    digits[--at] = ']';
    do {
        digits[--at] = (char)('0' + (int)(index % 10));
        index /= 10;
    } while (index != 0);
    digits[--at] = '[';
    shmgen_path_put(path, digits + at);
}

/* The status, and the field that it is about in front of what is known of the path. */
static inline shmgen_status shmgen_at(shmgen_path *path, const char *name, shmgen_status status)
{
    const char *inner = shmgen_path_text(path);
    if (*inner != 0 && *inner != '[')
        shmgen_path_put(path, ".");
    shmgen_path_put(path, name);
    return status;
}

/* The same for an element of the field. */
static inline shmgen_status shmgen_at_element(shmgen_path *path, const char *name, uint32_t index, shmgen_status status)
{
    if (*shmgen_path_text(path) != 0)
        shmgen_path_put(path, ".");
    shmgen_path_index(path, index);
    return shmgen_at(path, name, status);
}

/* Whether a text of so many characters, the last of which may be its NUL, ends within them. */
static inline int shmgen_ends(const char *text, size_t room)
{
    return memchr(text, 0, room) != NULL;
}

/* The same of a wide one, wherever it lies. */
static inline int shmgen_ends_wide(const void *text, size_t room)
{
    const unsigned char *bytes = (const unsigned char *)text;
    for (size_t index = 0; index < room; index++)
        if (bytes[2 * index] == 0 && bytes[2 * index + 1] == 0)
            return 1;
    return 0;
}

#ifdef __cplusplus
}
#endif

#endif
