/* Litmus tests: small programs with known races, which the explorer must find, or must not find. */
#include "explorer.h"

static uint32_t *word(int number)
{
    return (uint32_t *)(void *)(files[FILES - 1] + 64 * number);
}

/* Two actors each add 1 without a lock. */
static void adder(void)
{
    uint32_t value = __atomic_load_n(word(0), __ATOMIC_ACQUIRE);
    __atomic_store_n(word(0), value + 1, __ATOMIC_RELEASE);
    if (setting("last", 0) && !is_alive(0) && *word(0) != 2)
        fail("LOST: one of two additions is lost");
}

/* Two actors each store their own word, then load the other word. With store buffers, both may load 0, except if fence=1. */
static void store_then_load(void)
{
    const int mine = self, other = 1 - self;
    __atomic_store_n(word(mine), 1, __ATOMIC_RELEASE);
    if (setting("fence", 0))
        __atomic_thread_fence(__ATOMIC_SEQ_CST);
    check_values[150 + mine] = 1 + __atomic_load_n(word(other), __ATOMIC_ACQUIRE);
    if (check_values[150] == 1 && check_values[151] == 1)
        fail("PASSED: both loads passed the stores");
}

/* Store two plain words in order. An actor that loads the second value also loads the first, even with store buffers. */
static void sender(void)
{
    *word(0) = 1;
    *word(1) = 1;
}

static void receiver(void)
{
    const uint32_t second = *(volatile uint32_t *)word(1), first = *(volatile uint32_t *)word(0);
    if (second == 1 && first == 0)
        fail("REORDERED: two stores changed their order");
}

/* Copy 16 bytes. Another actor can observe an incomplete copy. */
typedef struct halves { uint64_t first, second; } halves;

static void copier(void)
{
    static const halves ones = {1, 1};
    *(halves *)(void *)word(0) = ones;
}

static void checker(void)
{
    const halves seen = *(volatile halves *)(void *)word(0);
    if (seen.first != seen.second)
        fail("HALF: a copy is incomplete");
}

const endpoint litmus_endpoints[] = {{"adder", adder}, {"store_then_load", store_then_load}, {"sender", sender},
    {"receiver", receiver}, {"copier", copier}, {"checker", checker}, {NULL, NULL}};
