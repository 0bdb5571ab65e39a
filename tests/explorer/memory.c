/* Shared memory: each load, each store and each piece of a copy is a step; on x86-64 stores are buffered.
 *
 * The ends are compiled as they are, with -fsanitize=thread, which makes gcc call what is below: __tsan_atomic... in place
 * of each atomic access, and __tsan_read..., __tsan_write... in front of each other one. The sanitizer itself is not
 * linked. Of a plain store the value is not known yet when it is announced: so it is taken back at the next call, and
 * then goes its way. For a plain load the memory shows, until the next call, what this actor sees.
 */
#include "explorer.h"

#include <string.h>

#define BUFFERED 24
#define PIECES 32

unsigned char files[FILES][FILE_SIZE] __attribute__((aligned(4096)));

typedef struct piece { /* within one aligned word of eight bytes */
    unsigned char *at;
    uint64_t value;
    int size;
} piece;

static piece buffers[ACTORS][BUFFERED];
static int buffered[ACTORS];
static piece shown[PIECES]; /* what memory holds instead, at most until the next call */
static int shown_count;
static bool is_store;
static uint64_t hash;

static bool is_shared(const volatile void *at)
{
    return (uintptr_t)at - (uintptr_t)files < sizeof files;
}

uint64_t get(const void *at, int size)
{
    uint64_t value = 0;
    __builtin_memcpy(&value, at, (size_t)size);
    return value;
}

static uint64_t word_hash(const void *at)
{
    return mixed((uintptr_t)at, *(const uint64_t *)at);
}

void put(const void *at, uint64_t value, int size)
{
    const void *word = (const void *)((uintptr_t)at & ~(uintptr_t)7);
    hash ^= word_hash(word);
    __builtin_memcpy((void *)(uintptr_t)at, &value, (size_t)size);
    hash ^= word_hash(word);
}

uint64_t memory_hash(void)
{
    uint64_t all = hash;
    for (int i = 0; i < ACTORS; i++)
        for (const piece *one = buffers[i]; one < buffers[i] + buffered[i]; one++)
            all = mixed(mixed(all, (uintptr_t)one->at * 8 + (unsigned)i), one->value);
    return all;
}

void memory_reset(void)
{
    memset(files, 0, sizeof files);
    memset(buffered, 0, sizeof buffered);
    shown_count = 0;
    hash = 0;
}

/* --- store buffers ----------------------------------------------------------------------------------------- */

static void let_out_first(int actor, int count)
{
    piece *first = buffers[actor];
    for (int i = 0; i < count; i++)
        put(first[i].at, first[i].value, first[i].size);
    buffered[actor] -= count;
    memmove(first, first + count, (size_t)buffered[actor] * sizeof *first);
}

void let_out(int actor)
{
    let_out_first(actor, buffered[actor]);
}

/* In front of a step: all stores are out by now, or some are held back, which is counted. */
static void hold(void)
{
    option stay[BUFFERED + 1];
    const int count = buffered[self];
    int held = 0;
    if (!quiet && left[HOLDS] > 0 && count > 0) {
        for (int i = 0; i <= count; i++)
            stay[i] = (option){'&', i};
        held = choose(stay, count + 1).which;
    }
    if (held > 0) {
        left[HOLDS]--;
        say("(%d stores are not out)", held);
    }
    let_out_first(self, count - held);
}

/* What this actor sees there: memory, and what it has stored itself. */
static uint64_t seen(const void *at, int size)
{
    const uintptr_t word = (uintptr_t)at & ~(uintptr_t)7;
    uint64_t value = get((const void *)word, 8);
    for (const piece *one = buffers[self]; one < buffers[self] + buffered[self]; one++)
        if (((uintptr_t)one->at & ~(uintptr_t)7) == word)
            __builtin_memcpy((unsigned char *)&value + ((uintptr_t)one->at - word), &one->value, (size_t)one->size);
    value >>= 8 * ((uintptr_t)at - word);
    return size < 8 ? value & ((UINT64_C(1) << 8 * size) - 1) : value;
}

/* --- loads and stores -------------------------------------------------------------------------------------- */

static uint64_t load(const void *at, int size)
{
    uint64_t value;
    hold();
    turn(false);
    value = seen(at, size);
    saw('r', at, value);
    say("%s is %llx", name_of(at), (unsigned long long)value);
    return value;
}

static void store(void *at, uint64_t value, int size)
{
    hold();
    turn(false);
    if (allowed[HOLDS] >= 0 && !quiet) {
        if (buffered[self] == BUFFERED)
            let_out_first(self, 1);
        buffers[self][buffered[self]++] = (piece){at, value, size};
    } else {
        put(at, value, size);
    }
    saw('w', at, value);
    say("%s := %llx", name_of(at), (unsigned long long)value);
}

void settle(void)
{
    piece made[PIECES];
    const int count = shown_count;
    const bool stores = is_store;
    shown_count = 0;
    for (int i = 0; i < count; i++) {
        made[i] = shown[i];
        made[i].value = get(shown[i].at, shown[i].size);
        __builtin_memcpy(shown[i].at, &shown[i].value, (size_t)shown[i].size); /* hash is of this */
    }
    for (int i = 0; i < count && stores; i++)
        store(made[i].at, made[i].value, made[i].size);
}

void step(void)
{
    settle();
    hold();
    turn(false);
}

static int size_of_piece(const void *at, size_t left_over)
{
    const size_t room = 8 - ((uintptr_t)at & 7);
    return (int)(left_over < room ? left_over : room);
}

/* A plain access: in pieces, so that others can see a copy half done, and be in the middle of one of their own. */
static void announced(void *start, size_t size, bool stores)
{
    unsigned char *at = start;
    piece own[PIECES];
    int count = 0;
    if (!is_shared(at))
        return;
    settle();
    for (; size > 0; count++) {
        const int bytes = size_of_piece(at, size);
        if (count == PIECES)
            fail("a copy of more than %d pieces", PIECES);
        own[count] = (piece){at, stores ? 0 : load(at, bytes), bytes};
        at += bytes;
        size -= (size_t)bytes;
    }
    for (int i = 0; i < count; i++) { /* only now: others have had their turns in between */
        const uint64_t shows = stores ? get(own[i].at, own[i].size) : own[i].value;
        shown[i] = own[i];
        shown[i].value = get(own[i].at, own[i].size);
        __builtin_memcpy(own[i].at, &shows, (size_t)own[i].size);
    }
    shown_count = count;
    is_store = stores;
}

/* memcpy of the ends (-Dmemcpy=explored_memcpy), piece by piece. */
void *explored_memcpy(void *to, const void *from, size_t size)
{
    if (!is_shared(to) && !is_shared(from))
        return __builtin_memcpy(to, from, size);
    settle();
    for (size_t at = 0; at < size;) {
        unsigned char *target = (unsigned char *)to + at;
        const unsigned char *source = (const unsigned char *)from + at;
        const int bytes = size_of_piece(is_shared(to) ? target : source, size - at);
        const uint64_t value = is_shared(source) ? load(source, bytes) : get(source, bytes);
        if (is_shared(target))
            store(target, value, bytes);
        else
            __builtin_memcpy(target, &value, (size_t)bytes);
        at += (size_t)bytes;
    }
    return to;
}

/* --- what the compiler calls ------------------------------------------------------------------------------- */

/* A locked instruction: the stores before it are out. */
static void locked(void)
{
    step();
    let_out(self);
}

#define ACCESS(bytes) \
    void __tsan_read##bytes(void *at) { announced(at, bytes, false); } \
    void __tsan_write##bytes(void *at) { announced(at, bytes, true); }
#define ATOMIC(bits) \
    uint##bits##_t __tsan_atomic##bits##_load(const volatile uint##bits##_t *at, int order) \
    { \
        (void)order; \
        if (!is_shared(at)) \
            return *at; \
        settle(); \
        return (uint##bits##_t)load((const void *)(uintptr_t)at, bits / 8); \
    } \
    void __tsan_atomic##bits##_store(volatile uint##bits##_t *at, uint##bits##_t value, int order) \
    { \
        if (!is_shared(at)) { \
            *at = value; \
            return; \
        } \
        settle(); \
        store((void *)(uintptr_t)at, value, bits / 8); \
        if (order == __ATOMIC_SEQ_CST) \
            let_out(self); \
    } \
    uint##bits##_t __tsan_atomic##bits##_exchange(volatile uint##bits##_t *at, uint##bits##_t value, int order) \
    { \
        uint##bits##_t before = *at; \
        (void)order; \
        if (is_shared(at)) { \
            locked(); \
            before = *at; \
            put((const void *)(uintptr_t)at, value, bits / 8); \
            saw('x', (const void *)(uintptr_t)at, before); \
            say("%s := %llx, was %llx", name_of((const void *)(uintptr_t)at), (unsigned long long)value, \
                (unsigned long long)before); \
        } else { \
            *at = value; \
        } \
        return before; \
    }

ACCESS(1)
ACCESS(2)
ACCESS(4)
ACCESS(8)
ACCESS(16)
ATOMIC(8)
ATOMIC(16)
ATOMIC(32)
ATOMIC(64)

/* Those who wait for a semaphore are counted in its upper half. What was there is looked at by nobody. */
uint64_t __tsan_atomic64_fetch_add(volatile uint64_t *at, uint64_t value, int order)
{
    (void)order;
    locked();
    put((const void *)(uintptr_t)at, *at + value, 8);
    return 0;
}

uint64_t __tsan_atomic64_fetch_sub(volatile uint64_t *at, uint64_t value, int order)
{
    return __tsan_atomic64_fetch_add(at, -value, order);
}

void __tsan_read_range(void *at, size_t size) { announced(at, size, false); }
void __tsan_write_range(void *at, size_t size) { announced(at, size, true); }
void __tsan_init(void) {}
void __tsan_func_entry(void *caller) { (void)caller; }
void __tsan_func_exit(void) {}

void __tsan_atomic_thread_fence(int order)
{
    settle();
    if (order == __ATOMIC_SEQ_CST)
        let_out(self);
}
