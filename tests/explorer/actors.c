/* Actors are endpoints in coroutines. Before each step of an actor, another may continue, or the actor may crash or stall. */
#include "explorer.h"

#include <stdarg.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#define STACK (128 * 1024)
#define WORDS 4
#define STALL_NS (2000 * MS)
#define STEPS 30000

enum actor_state { READY, SLEEPS, ENDED, CRASHED };

typedef struct actor {
    const char *text; /* "reader n=3" */
    const endpoint *endpoint;
    void *stack;
    enum actor_state state;
    bool crashes, stalls;
    int64_t wake;
    sleep_word words[WORDS];
    int words_count, woken; /* woken: 1 + index of the word on which an actor has woken this one */
    long steps;
    uint64_t observed;
} actor;

static actor actors[ACTORS];
static int actors_count;
static char stacks[ACTORS][STACK] __attribute__((aligned(64)));
static void *main_stack;
static long steps;

int allowed[BUDGETS], left[BUDGETS], self, stalls;
bool without_steps, printing;
int64_t now, limit;
uint64_t check_values[CHECK_VALUES];
char failure[256], scene_settings[512];

/* --- coroutines -------------------------------------------------------------------------------------------- */

void switch_stack(void **from, void *to);
__asm__(".globl switch_stack\nswitch_stack:\n push %rbp\n push %rbx\n push %r12\n push %r13\n push %r14\n push %r15\n"
        " mov %rsp,(%rdi)\n mov %rsi,%rsp\n pop %r15\n pop %r14\n pop %r13\n pop %r12\n pop %rbx\n pop %rbp\n ret\n");

void end_schedule(void)
{
    void *never;
    switch_stack(&never, main_stack);
}

static void finish(enum actor_state state)
{
    flush_stores(self);
    actors[self].state = state;
    close_all(self);
}

static void act(void)
{
    actors[self].endpoint->run();
    step(); /* others may continue before the last stores leave the buffer */
    trace("ends");
    finish(ENDED);
    pick_next_actor(true);
}

static void reset(actor *one)
{
    void **top = (void **)(void *)(stacks[one - actors] + STACK - 64);
    *--top = NULL;
    *--top = (void *)act;
    for (int i = 0; i < 6; i++)
        *--top = NULL;
    one->stack = top;
    one->state = READY;
    one->steps = one->wake = one->words_count = one->woken = 0;
    one->observed = (uint64_t)(one - actors);
}

void add_actor(const char *text)
{
    static const endpoint *const all[] = {c_endpoints, call_endpoints, plc_endpoints, litmus_endpoints};
    actor *one = &actors[actors_count++];
    const size_t length = strcspn(text, " ");
    if (actors_count <= ACTORS)
        for (int i = 0; i < 4; i++)
            for (const endpoint *candidate = all[i]; candidate->name != NULL; candidate++)
                if (strlen(candidate->name) == length && strncmp(candidate->name, text, length) == 0)
                    one->endpoint = candidate;
    if (actors_count > ACTORS || one->endpoint == NULL) {
        fprintf(stderr, "unknown endpoint, or too many: %s\n", text);
        exit(2);
    }
    one->text = text;
    self = actors_count - 1;
    one->crashes = setting("crash", 0) != 0;
    one->stalls = setting("stall", 0) != 0;
}

/* Set `*value` to the number after " name=" in a text. */
static bool find_setting(const char *text, const char *name, int64_t *value)
{
    const size_t length = strlen(name);
    for (const char *at = text; (at = strchr(at, ' ')) != NULL; at++)
        if (strncmp(at + 1, name, length) == 0 && at[1 + length] == '=') {
            *value = strtoll(at + length + 2, NULL, 0);
            return true;
        }
    return false;
}

int64_t setting(const char *name, int64_t fallback)
{
    if (actors[self].text == NULL || !find_setting(actors[self].text, name, &fallback))
        find_setting(scene_settings, name, &fallback);
    return fallback;
}

/* --- steps ------------------------------------------------------------------------------------------------- */

static bool is_wake_due(const actor *one)
{
    if (one->wake <= now || one->woken != 0)
        return true;
    for (int i = 0; i < one->words_count; i++)
        if (!one->words[i].wants_wake && (uint32_t)get(one->words[i].at, 4) != one->words[i].value)
            return true;
    return false;
}

static bool can_run(const actor *one)
{
    return one->state == READY || (one->state == SLEEPS && is_wake_due(one));
}

/* Advance the clock to the next wake-up, because all actors sleep. */
static void advance_clock(void)
{
    int64_t next = NEVER;
    for (int i = 0; i < actors_count; i++)
        if (actors[i].state == SLEEPS && actors[i].wake < next)
            next = actors[i].wake;
    if (next == NEVER) {
        for (int i = 0; i < actors_count; i++)
            if (actors[i].state == SLEEPS)
                fail("STUCK: %c sleeps forever", 'A' + i);
        end_schedule();
    }
    now = next;
    if (limit != 0 && now > limit)
        fail("SLOW: the scene exceeds its time limit");
}

static int list_options(option *options, bool yields)
{
    const actor *me = &actors[self];
    const bool can = can_run(me);
    int count = 0;
    if (can)
        options[count++] = (option){'>', self};
    for (int i = 0; i < actors_count; i++)
        if (i != self && can_run(&actors[i]) && (!can || yields || left[PREEMPTIONS] > 0))
            options[count++] = (option){'>', i};
    if (can && me->crashes && left[CRASHES] > 0)
        options[count++] = (option){'!', self};
    if (can && me->stalls && left[STALLS] > 0 && me->state == READY)
        options[count++] = (option){'~', self};
    return count;
}

static void crash(void)
{
    left[CRASHES]--;
    trace("CRASHES");
    finish(CRASHED);
}

static void stall(void)
{
    actor *me = &actors[self];
    left[STALLS]--;
    stalls++;
    trace("STALLS for 2 s");
    flush_stores(self);
    me->state = SLEEPS;
    me->wake = now + STALL_NS;
    me->words_count = me->woken = 0;
}

void pick_next_actor(bool yields)
{
    const int me = self;
    if (without_steps)
        return;
    actors[me].steps++;
    if (++steps > STEPS)
        fail("ENDLESS: the schedule has not ended after %d steps", STEPS);
    for (bool chosen = false; !chosen;) {
        option options[ACTORS + 2], next;
        const bool forced = yields || !can_run(&actors[self]);
        const int count = list_options(options, yields);
        if (count == 0) {
            advance_clock();
            continue;
        }
        next = choose(options, count);
        chosen = next.kind == '>';
        if (next.kind == '!')
            crash();
        else if (next.kind == '~')
            stall();
        else if (next.which != self) {
            trace(forced ? "... yields to %c" : "... is pre-empted by %c", 'A' + next.which);
            if (!forced && allowed[PREEMPTIONS] < UNBOUNDED)
                left[PREEMPTIONS]--;
            self = next.which;
        }
    }
    actors[self].state = READY;
    if (self != me)
        switch_stack(&actors[me].stack, actors[self].stack); /* returns when `me` is chosen again */
}

/* --- sleeping ---------------------------------------------------------------------------------------------- */

int sleep_until(int64_t until, const sleep_word *words, int count)
{
    actor *me = &actors[self];
    int which = -1;
    if (without_steps) {
        now = until;
        return -1;
    }
    flush_stores(self);
    me->state = SLEEPS;
    me->wake = until;
    me->words_count = count;
    me->woken = 0;
    for (int i = 0; i < count; i++)
        me->words[i] = words[i];
    pick_next_actor(true);
    if (me->woken != 0)
        which = me->woken - 1;
    for (int i = 0; i < count && which < 0; i++)
        if (!words[i].wants_wake && (uint32_t)get(words[i].at, 4) != words[i].value)
            which = i;
    me->words_count = 0;
    observe('z', NULL, mix((uint64_t)which, (uint64_t)now));
    return which;
}

void pause_ms(int64_t ms)
{
    trace("sleeps for %lld ms", (long long)ms);
    sleep_until(now + ms * MS, NULL, 0);
}

/* Return the index of `word` among the words on which a sleeping actor can be woken, or -1. */
static int index_of_wake_word(const actor *one, const void *word)
{
    for (int i = 0; i < one->words_count && one->state == SLEEPS && one->woken == 0; i++)
        if (one->words[i].at == word && one->words[i].wants_wake)
            return i;
    return -1;
}

int wake(const void *word, int count)
{
    int woken = 0;
    while (!without_steps && woken < count) {
        option sleepers[ACTORS], next;
        int sleeper_count = 0;
        for (int i = 0; i < actors_count; i++)
            if (index_of_wake_word(&actors[i], word) >= 0)
                sleepers[sleeper_count++] = (option){'*', i};
        if (sleeper_count == 0)
            break;
        next = sleeper_count <= count - woken ? sleepers[0] : choose(sleepers, sleeper_count);
        actors[next.which].woken = index_of_wake_word(&actors[next.which], word) + 1;
        trace("wakes %c", 'A' + next.which);
        woken++;
    }
    observe('k', word, (uint64_t)woken);
    return woken;
}

bool is_alive(int actor)
{
    return actor < actors_count && actors[actor].state != CRASHED && actors[actor].state != ENDED;
}

bool has_crashed(int actor)
{
    return actor < actors_count && actors[actor].state == CRASHED;
}

long steps_of(int actor)
{
    return actors[actor].steps;
}

/* --- observed values and output ---------------------------------------------------------------------------- */

void observe(char what, const void *at, uint64_t value)
{
    actor *me = &actors[self];
    me->observed = mix(mix(me->observed, (uint64_t)(unsigned char)what << 56 ^ (uint64_t)(uintptr_t)at), value);
}

uint64_t state_hash(void)
{
    uint64_t hash = mix(mix(memory_hash(), files_hash()), (uint64_t)now);
    for (const actor *one = actors; one < actors + actors_count; one++) {
        hash = mix(mix(hash, one->observed * 4 + one->state), (uint64_t)one->steps); /* a step may observe nothing */
        if (one->state == SLEEPS)
            hash = mix(hash, (uint64_t)one->wake * 8 + (uint64_t)one->woken);
    }
    for (uint64_t i = 0; i < CHECK_VALUES; i++)
        if (check_values[i] != 0)
            hash = mix(hash, check_values[i] * 256 + i);
    return hash;
}

void print_step(const char *format, ...)
{
    va_list values;
    printf("%9.1f ms %*s%c%-4ld", (double)(now - 1000000 * MS) / (double)MS, self * 20, "", 'A' + self, actors[self].steps);
    va_start(values, format);
    vprintf(format, values);
    va_end(values);
    putchar('\n');
}

void fail(const char *format, ...)
{
    va_list values;
    if (*failure == 0) {
        va_start(values, format);
        vsnprintf(failure, sizeof failure, format, values);
        va_end(values);
    }
    trace("** %s", failure);
    if (!without_steps)
        end_schedule();
}

/* --- one schedule ------------------------------------------------------------------------------------------ */

long run_actors(void)
{
    option first[ACTORS];
    steps = stalls = self = 0;
    *failure = 0;
    now = 1000000 * MS;
    for (int i = 0; i < BUDGETS; i++)
        left[i] = allowed[i];
    memset(check_values, 0, sizeof check_values);
    memory_reset();
    files_reset();
    for (int i = 0; i < actors_count; i++) {
        reset(&actors[i]);
        first[i] = (option){'>', i};
    }
    without_steps = true;
    set_up();
    without_steps = false;
    limit = setting("ms", 0) != 0 ? now + setting("ms", 0) * MS : 0;
    self = choose(first, actors_count).which;
    switch_stack(&main_stack, actors[self].stack);
    return steps;
}
