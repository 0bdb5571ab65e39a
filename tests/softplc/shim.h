/* SysShm and SysSemProcess as a CODESYS runtime on Linux offers them, on shm_open and sem_open; a stand-in for tests.
 *
 * Results are those of CmpErrors: 0 OK, 1 FAILED, 2 PARAMETER, 5 TIMEOUT, 15 BUFFERSIZE, 16 NO_OBJECT, 17 NOMEMORY,
 * 18 DUPLICATE, 25 NO_ACCESS_RIGHTS. An invalid handle has all bits set.
 */
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
uint32_t shim_sem_delete(uint64_t handle); /* here: gives the handle back, the file stays; of CODESYS nobody knows */
uint32_t shim_now(void); /* [ms], for TIME() */

/* What tests set and ask. */
void shim_sem_born(unsigned value);                        /* of semaphores made from now on: 0 or 1 */
void shim_shm_round(int rounded);                          /* sizes: 0 = exact, 1 = rounded up to pages first */
void shim_fail(const char *function, uint32_t result);     /* the next calls of it give this result; 0 = no longer */
void shim_set_now(uint32_t ms);                            /* stops the clock there */
void shim_run_now(void);                                   /* lets it run again */
uint32_t shim_waits(void);                                 /* how often Enter had a time limit other than 0 */

/* Calls `call(self, 0)` each period; gives the longest time that one took, in ns, or ends at the first `*reason`. */
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
