/* Shared memory: each load, each store and each piece of a copy is a step. Stores are buffered as on x86-64.
 *
 * With -fsanitize=thread, gcc compiles the endpoints with calls of the functions below: __tsan_atomic... instead of each
 * atomic access, and __tsan_read... or __tsan_write... before each plain access. The sanitizer itself is not linked. The
 * call before a plain store does not contain the value. Therefore, the next call reads the stored value, restores the old
 * value, and buffers the store. For a plain load, the memory contains this actor's view until the next call. */
#include "explorer.h"

#include <string.h>

#define BUFFERED 24
#define PIECES 32

unsigned char files[FILES][FILE_SIZE] __attribute__((aligned(4096)));

typedef struct piece { /* a part of one aligned word of eight bytes */
    unsigned char *at;
    uint64_t value;
    int size;
} piece;

static piece buffers[ACTORS][BUFFERED];
static int buffered[ACTORS];
static piece overlay[PIECES]; /* actual values that plain_access() replaced; restored at the next call */
static int overlay_count;
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
    return mix((uintptr_t)at, *(const uint64_t *)at);
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
            all = mix(mix(all, (uintptr_t)one->at * 8 + (unsigned)i), one->value);
    return all;
}

void memory_reset(void)
{
    memset(files, 0, sizeof files);
    memset(buffered, 0, sizeof buffered);
    overlay_count = 0;
    hash = 0;
}

/* --- store buffers ----------------------------------------------------------------------------------------- */

static void flush_first_stores(int actor, int count)
{
    piece *first = buffers[actor];
    for (int i = 0; i < count; i++)
        put(first[i].at, first[i].value, first[i].size);
    buffered[actor] -= count;
    memmove(first, first + count, (size_t)buffered[actor] * sizeof *first);
}

void flush_stores(int actor)
{
    flush_first_stores(actor, buffered[actor]);
}

/* Before a step, empty the store buffer, or hold some stores back if the budget allows. */
static void hold_stores(void)
{
    option counts[BUFFERED + 1];
    const int count = buffered[self];
    int buffered = 0;
    if (!without_steps && left[HOLDS] > 0 && count > 0) {
        for (int i = 0; i <= count; i++)
            counts[i] = (option){'&', i};
        buffered = choose(counts, count + 1).which;
    }
    if (buffered > 0) {
        left[HOLDS]--;
        trace("(%d stores stay in the buffer)", buffered);
    }
    flush_first_stores(self, count - buffered);
}

/* Return the value that this actor loads: the memory, changed by the stores in the actor's own buffer. */
static uint64_t own_view(const void *at, int size)
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
    hold_stores();
    pick_next_actor(false);
    value = own_view(at, size);
    observe('r', at, value);
    trace("%s is %llx", name_of(at), (unsigned long long)value);
    return value;
}

static void store(void *at, uint64_t value, int size)
{
    hold_stores();
    pick_next_actor(false);
    if (allowed[HOLDS] >= 0 && !without_steps) {
        if (buffered[self] == BUFFERED)
            flush_first_stores(self, 1);
        buffers[self][buffered[self]++] = (piece){at, value, size};
    } else {
        put(at, value, size);
    }
    observe('w', at, value);
    trace("%s := %llx", name_of(at), (unsigned long long)value);
}

void finish_access(void)
{
    piece written[PIECES];
    const int count = overlay_count;
    const bool stores = is_store;
    overlay_count = 0;
    for (int i = 0; i < count; i++) {
        written[i] = overlay[i];
        written[i].value = get(overlay[i].at, overlay[i].size);
        __builtin_memcpy(overlay[i].at, &overlay[i].value, (size_t)overlay[i].size); /* `hash` covers this value */
    }
    for (int i = 0; i < count && stores; i++)
        store(written[i].at, written[i].value, written[i].size);
}

void step(void)
{
    finish_access();
    hold_stores();
    pick_next_actor(false);
}

static int size_of_piece(const void *at, size_t left_over)
{
    const size_t rest = 8 - ((uintptr_t)at & 7);
    return (int)(left_over < rest ? left_over : rest);
}

/* Divide a plain access into pieces, so that other actors can observe an incomplete copy. */
static void plain_access(void *start, size_t size, bool stores)
{
    unsigned char *at = start;
    piece pieces[PIECES];
    int count = 0;
    if (!is_shared(at))
        return;
    finish_access();
    for (; size > 0; count++) {
        const int bytes = size_of_piece(at, size);
        if (count == PIECES)
            fail("a copy has more than %d pieces", PIECES);
        pieces[count] = (piece){at, stores ? 0 : load(at, bytes), bytes};
        at += bytes;
        size -= (size_t)bytes;
    }
    for (int i = 0; i < count; i++) { /* after all loads, because other actors run in between */
        const uint64_t shows = stores ? get(pieces[i].at, pieces[i].size) : pieces[i].value;
        overlay[i] = pieces[i];
        overlay[i].value = get(pieces[i].at, pieces[i].size);
        __builtin_memcpy(pieces[i].at, &shows, (size_t)pieces[i].size);
    }
    overlay_count = count;
    is_store = stores;
}

/* The endpoints' memcpy (-Dmemcpy=explored_memcpy), divided into pieces. */
void *explored_memcpy(void *to, const void *from, size_t size)
{
    if (!is_shared(to) && !is_shared(from))
        return __builtin_memcpy(to, from, size);
    finish_access();
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

/* --- calls that the compiler adds --------------------------------------------------------------------------- */

/* Begin a locked instruction, which empties the store buffer. */
static void begin_locked_instruction(void)
{
    step();
    flush_stores(self);
}

#define ACCESS(bytes) \
    void __tsan_read##bytes(void *at) { plain_access(at, bytes, false); } \
    void __tsan_write##bytes(void *at) { plain_access(at, bytes, true); }
#define ATOMIC(bits) \
    uint##bits##_t __tsan_atomic##bits##_load(const volatile uint##bits##_t *at, int order) \
    { \
        (void)order; \
        if (!is_shared(at)) \
            return *at; \
        finish_access(); \
        return (uint##bits##_t)load((const void *)(uintptr_t)at, bits / 8); \
    } \
    void __tsan_atomic##bits##_store(volatile uint##bits##_t *at, uint##bits##_t value, int order) \
    { \
        if (!is_shared(at)) { \
            *at = value; \
            return; \
        } \
        finish_access(); \
        store((void *)(uintptr_t)at, value, bits / 8); \
        if (order == __ATOMIC_SEQ_CST) \
            flush_stores(self); \
    } \
    uint##bits##_t __tsan_atomic##bits##_exchange(volatile uint##bits##_t *at, uint##bits##_t value, int order) \
    { \
        uint##bits##_t before = *at; \
        (void)order; \
        if (is_shared(at)) { \
            begin_locked_instruction(); \
            before = *at; \
            put((const void *)(uintptr_t)at, value, bits / 8); \
            observe('x', (const void *)(uintptr_t)at, before); \
            trace("%s := %llx, was %llx", name_of((const void *)(uintptr_t)at), (unsigned long long)value, \
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

/* Add to the count of waiters in the upper half of a semaphore. No caller uses the returned value. */
uint64_t __tsan_atomic64_fetch_add(volatile uint64_t *at, uint64_t value, int order)
{
    (void)order;
    begin_locked_instruction();
    put((const void *)(uintptr_t)at, *at + value, 8);
    return 0;
}

uint64_t __tsan_atomic64_fetch_sub(volatile uint64_t *at, uint64_t value, int order)
{
    return __tsan_atomic64_fetch_add(at, -value, order);
}

void __tsan_read_range(void *at, size_t size) { plain_access(at, size, false); }
void __tsan_write_range(void *at, size_t size) { plain_access(at, size, true); }
void __tsan_init(void) {}
void __tsan_func_entry(void *caller) { (void)caller; }
void __tsan_func_exit(void) {}

void __tsan_atomic_thread_fence(int order)
{
    finish_access();
    if (order == __ATOMIC_SEQ_CST)
        flush_stores(self);
}
