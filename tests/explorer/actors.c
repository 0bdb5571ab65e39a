/* Actors are ends in coroutines; in front of each step of one another may go on, or it may crash or stand still. */
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
    const end *end;
    void *stack;
    enum actor_state state;
    bool crashes, stalls;
    int64_t wake;
    sleep_word words[WORDS];
    int words_count, woken; /* woken: 1 + the word for which somebody has woken it */
    long steps;
    uint64_t learnt;
} actor;

static actor actors[ACTORS];
static int actors_count;
static char stacks[ACTORS][STACK] __attribute__((aligned(64)));
static void *main_stack;
static long steps;

int allowed[BUDGETS], left[BUDGETS], self, stalls;
bool quiet, printing;
int64_t now, limit;
uint64_t known[KNOWN];
char failure[256], scene_settings[512];

/* --- coroutines -------------------------------------------------------------------------------------------- */

void switch_stack(void **from, void *to);
__asm__(".globl switch_stack\nswitch_stack:\n push %rbp\n push %rbx\n push %r12\n push %r13\n push %r14\n push %r15\n"
        " mov %rsp,(%rdi)\n mov %rsi,%rsp\n pop %r15\n pop %r14\n pop %r13\n pop %r12\n pop %rbx\n pop %rbp\n ret\n");

void leave(void)
{
    void *never;
    switch_stack(&never, main_stack);
}

static void finish(enum actor_state state)
{
    let_out(self);
    actors[self].state = state;
    close_all(self);
}

static void act(void)
{
    actors[self].end->run();
    step(); /* others may go on before its last stores are out */
    say("ends");
    finish(ENDED);
    turn(true);
}

static void reset(actor *who)
{
    void **top = (void **)(void *)(stacks[who - actors] + STACK - 64);
    *--top = NULL;
    *--top = (void *)act;
    for (int i = 0; i < 6; i++)
        *--top = NULL;
    who->stack = top;
    who->state = READY;
    who->steps = who->wake = who->words_count = who->woken = 0;
    who->learnt = (uint64_t)(who - actors);
}

void add_actor(const char *text)
{
    static const end *const all[] = {c_ends, call_ends, plc_ends, litmus_ends};
    actor *who = &actors[actors_count++];
    const size_t length = strcspn(text, " ");
    if (actors_count <= ACTORS)
        for (int i = 0; i < 4; i++)
            for (const end *one = all[i]; one->name != NULL; one++)
                if (strlen(one->name) == length && strncmp(one->name, text, length) == 0)
                    who->end = one;
    if (actors_count > ACTORS || who->end == NULL) {
        fprintf(stderr, "no such end, or too many: %s\n", text);
        exit(2);
    }
    who->text = text;
    self = actors_count - 1;
    who->crashes = told("crash", 0) != 0;
    who->stalls = told("stall", 0) != 0;
}

/* The number behind " name=" in a text. */
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

int64_t told(const char *name, int64_t usual)
{
    if (actors[self].text == NULL || !find_setting(actors[self].text, name, &usual))
        find_setting(scene_settings, name, &usual);
    return usual;
}

/* --- steps ------------------------------------------------------------------------------------------------- */

static bool wakes(const actor *who)
{
    if (who->wake <= now || who->woken != 0)
        return true;
    for (int i = 0; i < who->words_count; i++)
        if (!who->words[i].wants_wake && (uint32_t)get(who->words[i].at, 4) != who->words[i].value)
            return true;
    return false;
}

static bool can_go(const actor *who)
{
    return who->state == READY || (who->state == SLEEPS && wakes(who));
}

/* When nobody can go on, the clock does. */
static void let_time_pass(void)
{
    int64_t next = NEVER;
    for (int i = 0; i < actors_count; i++)
        if (actors[i].state == SLEEPS && actors[i].wake < next)
            next = actors[i].wake;
    if (next == NEVER) {
        for (int i = 0; i < actors_count; i++)
            if (actors[i].state == SLEEPS)
                fail("STUCK: %c sleeps for ever", 'A' + i);
        leave();
    }
    now = next;
    if (limit != 0 && now > limit)
        fail("SLOW: not done in time");
}

static int options_here(option *options, bool gives_way)
{
    const actor *me = &actors[self];
    const bool can = can_go(me);
    int count = 0;
    if (can)
        options[count++] = (option){'>', self};
    for (int i = 0; i < actors_count; i++)
        if (i != self && can_go(&actors[i]) && (!can || gives_way || left[PREEMPTIONS] > 0))
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
    say("CRASHES");
    finish(CRASHED);
}

static void stand_still(void)
{
    actor *me = &actors[self];
    left[STALLS]--;
    stalls++;
    say("STANDS STILL for 2 s");
    let_out(self);
    me->state = SLEEPS;
    me->wake = now + STALL_NS;
    me->words_count = me->woken = 0;
}

void turn(bool gives_way)
{
    const int me = self;
    if (quiet)
        return;
    actors[me].steps++;
    if (++steps > STEPS)
        fail("ENDLESS: no end after %d steps", STEPS);
    for (bool chosen = false; !chosen;) {
        option options[ACTORS + 2], next;
        const bool forced = gives_way || !can_go(&actors[self]);
        const int count = options_here(options, gives_way);
        if (count == 0) {
            let_time_pass();
            continue;
        }
        next = choose(options, count);
        chosen = next.kind == '>';
        if (next.kind == '!')
            crash();
        else if (next.kind == '~')
            stand_still();
        else if (next.which != self) {
            say(forced ? "... gives way to %c" : "... is pre-empted by %c", 'A' + next.which);
            if (!forced && allowed[PREEMPTIONS] < UNBOUNDED)
                left[PREEMPTIONS]--;
            self = next.which;
        }
    }
    actors[self].state = READY;
    if (self != me)
        switch_stack(&actors[me].stack, actors[self].stack); /* comes back when somebody has chosen `me` */
}

/* --- sleeping ---------------------------------------------------------------------------------------------- */

int sleep_until(int64_t until, const sleep_word *words, int count)
{
    actor *me = &actors[self];
    int which = -1;
    if (quiet) {
        now = until;
        return -1;
    }
    let_out(self);
    me->state = SLEEPS;
    me->wake = until;
    me->words_count = count;
    me->woken = 0;
    for (int i = 0; i < count; i++)
        me->words[i] = words[i];
    turn(true);
    if (me->woken != 0)
        which = me->woken - 1;
    for (int i = 0; i < count && which < 0; i++)
        if (!words[i].wants_wake && (uint32_t)get(words[i].at, 4) != words[i].value)
            which = i;
    me->words_count = 0;
    saw('z', NULL, mixed((uint64_t)which, (uint64_t)now));
    return which;
}

void pause_ms(int64_t ms)
{
    say("sleeps for %lld ms", (long long)ms);
    sleep_until(now + ms * MS, NULL, 0);
}

/* Which word of his an actor is to be woken for, -1: none. */
static int sleeps_for(const actor *who, const void *word)
{
    for (int i = 0; i < who->words_count && who->state == SLEEPS && who->woken == 0; i++)
        if (who->words[i].at == word && who->words[i].wants_wake)
            return i;
    return -1;
}

int wake(const void *word, int count)
{
    int woken = 0;
    while (!quiet && woken < count) {
        option sleepers[ACTORS], next;
        int found = 0;
        for (int i = 0; i < actors_count; i++)
            if (sleeps_for(&actors[i], word) >= 0)
                sleepers[found++] = (option){'*', i};
        if (found == 0)
            break;
        next = found <= count - woken ? sleepers[0] : choose(sleepers, found);
        actors[next.which].woken = sleeps_for(&actors[next.which], word) + 1;
        say("wakes %c", 'A' + next.which);
        woken++;
    }
    saw('k', word, (uint64_t)woken);
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

/* --- what is learnt, and told ------------------------------------------------------------------------------ */

void saw(char what, const void *at, uint64_t value)
{
    actor *me = &actors[self];
    me->learnt = mixed(mixed(me->learnt, (uint64_t)(unsigned char)what << 56 ^ (uint64_t)(uintptr_t)at), value);
}

uint64_t state_hash(void)
{
    uint64_t hash = mixed(mixed(memory_hash(), files_hash()), (uint64_t)now);
    for (const actor *who = actors; who < actors + actors_count; who++) {
        hash = mixed(mixed(hash, who->learnt * 4 + who->state), (uint64_t)who->steps); /* some tell it nothing: a close */
        if (who->state == SLEEPS)
            hash = mixed(hash, (uint64_t)who->wake * 8 + (uint64_t)who->woken);
    }
    for (uint64_t i = 0; i < KNOWN; i++)
        if (known[i] != 0)
            hash = mixed(hash, known[i] * 256 + i);
    return hash;
}

void tell(const char *format, ...)
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
    say("** %s", failure);
    if (!quiet)
        leave();
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
    memset(known, 0, sizeof known);
    memory_reset();
    files_reset();
    for (int i = 0; i < actors_count; i++) {
        reset(&actors[i]);
        first[i] = (option){'>', i};
    }
    quiet = true;
    set_up();
    quiet = false;
    limit = told("ms", 0) != 0 ? now + told("ms", 0) * MS : 0;
    self = choose(first, actors_count).which;
    switch_stack(&main_stack, actors[self].stack);
    return steps;
}
