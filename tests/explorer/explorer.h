/* What the parts of the explorer know of each other. README.md says how they work together. */
#ifndef EXPLORER_H
#define EXPLORER_H

#include <stdbool.h>
#include <stddef.h>
#include <stdint.h>

#ifdef __cplusplus
extern "C" {
#endif

#define ACTORS 6
#define KNOWN 160
#define NEVER INT64_MAX
#define MS INT64_C(1000000)

/* --- search.c: which of the possible comes next ------------------------------------------------------------ */

typedef struct option {
    char kind; /* '>' who goes on, '!' crashes, '~' stands still, '&' so many stores stay, '*' who is woken */
    int which; /* actor, or number */
} option;

option choose(const option *options, int count); /* each is tried; the first is what costs nothing */
uint64_t mixed(uint64_t hash, uint64_t value);

/* --- actors.c: coroutines that take turns ------------------------------------------------------------------ */

/* What an actor sleeps for, besides the time: that a word of memory is another, or is changed by one who wakes him. */
typedef struct sleep_word {
    const void *at;
    uint32_t value;
    bool wants_wake; /* false: wakes as soon as the word is another, as sem_wait does */
} sleep_word;

enum { PREEMPTIONS, CRASHES, STALLS, HOLDS, BUDGETS };
#define UNBOUNDED 90
extern int allowed[BUDGETS], left[BUDGETS]; /* in a schedule, and in what remains of this one; -1 HOLDS: no buffers */
extern int self;                            /* the actor whose step it is */
extern bool quiet;                          /* what happens now is no step: it is set up, or looked at afterwards */
extern bool printing;
extern int64_t now, limit;                  /* ns, by the only clock there is; limit 0: none */
extern int stalls;                          /* how many have stood still so far */
extern uint64_t known[KNOWN];                 /* what the checks remember; part of the state */
extern char failure[256];                   /* why the schedule fails, "": it does not */

void add_actor(const char *text);
long run_actors(void);         /* one schedule; returns its steps */
void leave(void);              /* ends the schedule */
uint64_t state_hash(void);
long steps_of(int actor);
void turn(bool gives_way);     /* before each step: others may go first, the actor may crash or stand still */
int sleep_until(int64_t wake, const sleep_word *words, int count); /* which word woke it, -1: the time */
int wake(const void *word, int count);                             /* those who sleep for it; returns how many */
void saw(char what, const void *at, uint64_t value); /* what an actor has learnt is part of its state */
void tell(const char *format, ...) __attribute__((format(printf, 1, 2)));
#define say(...) (printing && !quiet ? tell(__VA_ARGS__) : (void)0)
void fail(const char *format, ...) __attribute__((format(printf, 1, 2)));
bool is_alive(int actor);
bool has_crashed(int actor);
int64_t told(const char *name, int64_t usual); /* a setting of this actor, else of the scene */
extern char scene_settings[512];

/* --- memory.c: loads, stores, copies, and what of them is out ---------------------------------------------- */

#define FILES 12
#define FILE_SIZE 4096
extern unsigned char files[FILES][FILE_SIZE]; /* regions and semaphores */

void memory_reset(void);
uint64_t memory_hash(void);
void step(void);         /* what was stored goes its way, then turn(false) */
void settle(void);       /* the first half of it */
void let_out(int actor); /* all stores of an actor */
void put(const void *at, uint64_t value, int size); /* at once */
uint64_t get(const void *at, int size);

/* --- files.c (system.c is called by the ends alone) -------------------------------------------------------- */

void files_reset(void);
uint64_t files_hash(void);
void close_all(int actor); /* it is dead */
const char *name_of(const void *at);
#define PID_OF(actor) (1000 + (actor))

/* --- the ends: ends.c, calls.c, plc.cpp, litmus.c ---------------------------------------------------------- */

typedef struct end {
    const char *name;
    void (*run)(void);
} end;
extern const end c_ends[], call_ends[], plc_ends[], litmus_ends[]; /* name NULL behind the last */

void set_up(void);     /* before the actors */
void look_after(void); /* when all have ended */
void pause_ms(int64_t ms);

#ifdef __cplusplus
}
#endif

#endif
