/* What the explorer itself must find, and must not: the textbook's small programs. */
#include "explorer.h"

static uint32_t *word(int number)
{
    return (uint32_t *)(void *)(files[FILES - 1] + 64 * number);
}

/* Two add one each. */
static void adds(void)
{
    uint32_t value = __atomic_load_n(word(0), __ATOMIC_ACQUIRE);
    __atomic_store_n(word(0), value + 1, __ATOMIC_RELEASE);
    if (told("last", 0) && !is_alive(0) && *word(0) != 2)
        fail("LOST: one of two additions");
}

/* Each stores a word of its own, then loads the other's: with store buffers both may find 0. fence=1: never. */
static void stores_and_loads(void)
{
    const int mine = self, other = 1 - self;
    __atomic_store_n(word(mine), 1, __ATOMIC_RELEASE);
    if (told("fence", 0))
        __atomic_thread_fence(__ATOMIC_SEQ_CST);
    known[150 + mine] = 1 + __atomic_load_n(word(other), __ATOMIC_ACQUIRE);
    if (known[150] == 1 && known[151] == 1)
        fail("PASSED: both loads have passed the stores");
}

/* Two plain words, stored one after the other: who sees the second sees the first, buffers or not. */
static void sends(void)
{
    *word(0) = 1;
    *word(1) = 1;
}

static void receives(void)
{
    const uint32_t second = *(volatile uint32_t *)word(1), first = *(volatile uint32_t *)word(0);
    if (second == 1 && first == 0)
        fail("REORDERED: two stores");
}

/* A copy of 16 bytes can be seen half done. */
typedef struct halves { uint64_t first, second; } halves;

static void copies(void)
{
    static const halves ones = {1, 1};
    *(halves *)(void *)word(0) = ones;
}

static void looks(void)
{
    const halves seen = *(volatile halves *)(void *)word(0);
    if (seen.first != seen.second)
        fail("HALF: a copy");
}

const end litmus_ends[] = {{"adds", adds}, {"stores_and_loads", stores_and_loads}, {"sends", sends},
    {"receives", receives}, {"copies", copies}, {"looks", looks}, {NULL, NULL}};
