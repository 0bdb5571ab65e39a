/* Declarations shared by the parts of the explorer. README.md explains how the parts work together. */
#ifndef EXPLORER_H
#define EXPLORER_H

#include <stdbool.h>
#include <stddef.h>
#include <stdint.h>

#ifdef __cplusplus
extern "C" {
#endif

#define ACTORS 6
#define CHECK_VALUES 160
#define NEVER INT64_MAX
#define MS INT64_C(1000000)

/* --- search.c: choices between options --------------------------------------------------------------------- */

typedef struct option {
    char kind; /* '>' an actor continues, '!' crashes, '~' stalls, '*' is woken; '&' stores stay buffered */
    int which; /* actor, or number of stores */
} option;

option choose(const option *options, int count); /* tries each option in some schedule; the first option uses no budget */
uint64_t mix(uint64_t hash, uint64_t value);

/* --- actors.c: actors are coroutines ----------------------------------------------------------------------- */

/* A word on which an actor sleeps, in addition to a timeout. */
typedef struct sleep_word {
    const void *at;
    uint32_t value;
    bool wants_wake; /* true: another actor must wake the sleeper; false: a changed word ends the sleep, as in sem_wait */
} sleep_word;

enum { PREEMPTIONS, CRASHES, STALLS, HOLDS, BUDGETS };
#define UNBOUNDED 90
extern int allowed[BUDGETS], left[BUDGETS]; /* budgets of a schedule, and the rest in this schedule; HOLDS -1: no buffers */
extern int self;                            /* the running actor */
extern bool without_steps;                  /* calls are not steps: before the actors start, after they end */
extern bool printing;
extern int64_t now, limit;                  /* ns of the simulated clock; limit 0: none */
extern int stalls;                          /* number of stalls so far */
extern uint64_t check_values[CHECK_VALUES]; /* values that the checks store; part of the state */
extern char failure[256];                   /* the reason why a check failed, or "" */

void add_actor(const char *text);
long run_actors(void);         /* runs one schedule; returns its number of steps */
void end_schedule(void);
uint64_t state_hash(void);
long steps_of(int actor);
void pick_next_actor(bool yields); /* before each step: others may continue, or the actor may crash or stall */
int sleep_until(int64_t wake, const sleep_word *words, int count); /* returns the index of the changed word, or -1 */
int wake(const void *word, int count); /* wakes at most `count` actors; returns their number */
void observe(char what, const void *at, uint64_t value); /* adds to what this actor has read: a part of its state */
void print_step(const char *format, ...) __attribute__((format(printf, 1, 2)));
#define trace(...) (printing && !without_steps ? print_step(__VA_ARGS__) : (void)0)
void fail(const char *format, ...) __attribute__((format(printf, 1, 2)));
bool is_alive(int actor);
bool has_crashed(int actor);
int64_t setting(const char *name, int64_t fallback); /* of this actor, or else of the scene */
extern char scene_settings[512];

/* --- memory.c: loads, stores, copies and store buffers ----------------------------------------------------- */

#define FILES 12
#define FILE_SIZE 4096
extern unsigned char files[FILES][FILE_SIZE]; /* regions and semaphores */

void memory_reset(void);
uint64_t memory_hash(void);
void step(void);          /* finishes the last access, then calls pick_next_actor(false) */
void finish_access(void); /* moves a plain store from memory to the store buffer; ends a plain load */
void flush_stores(int actor); /* writes all buffered stores of an actor to memory */
void put(const void *at, uint64_t value, int size); /* writes to memory, without a buffer */
uint64_t get(const void *at, int size);

/* --- files.c (only endpoints call system.c) ---------------------------------------------------------------- */

void files_reset(void);
uint64_t files_hash(void);
void close_all(int actor); /* as at the end of a process */
const char *name_of(const void *at);
#define PID_OF(actor) (1000 + (actor))

/* --- the endpoints: endpoints.c, calls.c, plc.cpp, litmus.c ------------------------------------------------ */

typedef struct endpoint {
    const char *name;
    void (*run)(void);
} endpoint;
extern const endpoint c_endpoints[], call_endpoints[], plc_endpoints[], litmus_endpoints[]; /* the last name is NULL */

void set_up(void);          /* before the actors start */
void check_end_state(void); /* after all actors have ended */
void pause_ms(int64_t ms);

#ifdef __cplusplus
}
#endif

#endif
