/* A stand-in for the libraries SysShm and SysSemProcess of a CODESYS runtime on Linux, which uses shm_open and sem_open.
 *
 * Results are those of CODESYS's CmpErrors: 0 OK, 1 FAILED, 2 PARAMETER, 5 TIMEOUT, 15 BUFFERSIZE, 16 NO_OBJECT, 17 NOMEMORY,
 * 18 DUPLICATE, 25 NO_ACCESS_RIGHTS. An invalid handle has all bits set. */
#ifndef SHIM_H
#define SHIM_H

#include <stdint.h>

#ifdef __cplusplus
extern "C" {
#endif

uint64_t shim_shm_open(const char *name, uint64_t address, uint64_t *size, uint32_t *result);
uint64_t shim_shm_create(const char *name, uint64_t address, uint64_t *size, uint32_t *result);
void *shim_shm_pointer(uint64_t handle, uint32_t *result);
uint32_t shim_shm_close(uint64_t handle);
uint64_t shim_sem_create(const char *name, uint32_t *result);
uint32_t shim_sem_enter(uint64_t handle, uint32_t timeout_ms);
uint32_t shim_sem_leave(uint64_t handle);
uint32_t shim_sem_delete(uint64_t handle); /* keeps the file; CODESYS does not document whether it removes the file */
uint32_t shim_now(void); /* the value of TIME() in ms */

/* Functions for tests. */
void shim_set_initial_value(unsigned value);           /* the initial value of new semaphores: 0 or 1 */
void shim_round_sizes(int rounded);                    /* sizes of shared memory: 0 = exact, 1 = rounded up to pages */
void shim_fail(const char *function, uint32_t result); /* the next calls of `function` return this result; 0 = no failure */
void shim_stop_clock(uint32_t ms);                     /* stops the clock at this time */
void shim_restart_clock(void);                         /* restarts the clock */
uint32_t shim_waits(void);                             /* the number of calls of Enter with a time limit other than 0 */

/* Calls all programs once per period, until one fails with a `*reason`. Returns the duration of the longest cycle in ns. */
typedef struct shim_program {
    const char *(*call)(void *, void *);
    void *self;
} shim_program;
uint64_t shim_run(const shim_program *programs, uint64_t count, uint64_t period_ns, uint64_t cycles,
                  const char **reason);

#ifdef __cplusplus
}
#endif

#endif
