/* See shim.h. */
#define _GNU_SOURCE
#include "shim.h"

#include <errno.h>
#include <fcntl.h>
#include <semaphore.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/mman.h>
#include <sys/stat.h>
#include <time.h>
#include <unistd.h>

enum {
    OK = 0, FAILED = 1, PARAMETER = 2, TIMEOUT = 5, BUFFERSIZE = 15, NO_OBJECT = 16, NOMEMORY = 17, DUPLICATE = 18,
    NO_ACCESS_RIGHTS = 25
};
#define INVALID UINT64_MAX
#define PAGE 4096u

typedef struct {
    void *memory;
    uint64_t size;
} mapping;

static unsigned born = 1;
static int rounding = 0;
static uint32_t stopped_clock, waits;
static int clock_stands = 0;
static void (*on_leave)(void);
static struct {
    char function[32];
    uint32_t result;
} failing;

void shim_sem_born(unsigned value) { born = value; }
void shim_shm_round(int rounded) { rounding = rounded; }
uint32_t shim_waits(void) { return waits; }
void shim_on_leave(void (*call)(void)) { on_leave = call; }

void shim_fail(const char *function, uint32_t result) {
    snprintf(failing.function, sizeof failing.function, "%s", function);
    failing.result = result;
}

void shim_set_now(uint32_t ms) {
    stopped_clock = ms;
    clock_stands = 1;
}

void shim_run_now(void) { clock_stands = 0; }

uint32_t shim_now(void) {
    struct timespec now;
    if (clock_stands) return stopped_clock;
    clock_gettime(CLOCK_MONOTONIC, &now);
    return (uint32_t)(now.tv_sec * 1000ull + now.tv_nsec / 1000000);
}

static uint32_t failure(const char *function) {
    return strcmp(failing.function, function) == 0 ? failing.result : OK;
}

static uint32_t result_of(int error) {
    switch (error) {
    case ENOENT: return NO_OBJECT;
    case EACCES: return NO_ACCESS_RIGHTS;
    case ENOMEM: case ENOSPC: return NOMEMORY;
    case EINVAL: case ENAMETOOLONG: return PARAMETER;
    default: return FAILED;
    }
}

static const char *slashed(char *buffer, size_t room, const char *name) {
    snprintf(buffer, room, "%s%s", name[0] == '/' ? "" : "/", name);
    return buffer;
}

static uint64_t refused(uint32_t *result, uint32_t why) {
    *result = why;
    return INVALID;
}

static uint64_t rounded_up(uint64_t size) { return (size + PAGE - 1) / PAGE * PAGE; }

static uint64_t mapped(int file, uint64_t *size, uint32_t *result, uint32_t success) {
    struct stat status;
    mapping *made;
    fstat(file, &status);
    uint64_t real = (uint64_t)status.st_size;
    if (real != (rounding ? rounded_up(*size) : *size) || real == 0) {
        close(file);
        *size = real;
        return refused(result, BUFFERSIZE);
    }
    made = malloc(sizeof *made);
    made->size = real;
    made->memory = mmap(NULL, real, PROT_READ | PROT_WRITE, MAP_SHARED, file, 0);
    close(file);
    if (made->memory == MAP_FAILED) {
        free(made);
        return refused(result, NOMEMORY);
    }
    *result = success;
    return (uint64_t)(uintptr_t)made;
}

uint64_t shim_shm_open(const char *name, uint64_t address, uint64_t *size, uint32_t *result) {
    char buffer[256];
    uint32_t wanted = failure("SysSharedMemoryOpen2");
    if (wanted) return refused(result, wanted);
    if (address != 0) return refused(result, PARAMETER);
    int file = shm_open(slashed(buffer, sizeof buffer, name), O_RDWR, 0);
    return file < 0 ? refused(result, result_of(errno)) : mapped(file, size, result, OK);
}

uint64_t shim_shm_create(const char *name, uint64_t address, uint64_t *size, uint32_t *result) {
    char buffer[256];
    uint32_t wanted = failure("SysSharedMemoryCreate");
    if (wanted) return refused(result, wanted);
    if (address != 0) return refused(result, PARAMETER);
    int file = shm_open(slashed(buffer, sizeof buffer, name), O_RDWR | O_CREAT | O_EXCL, 0660);
    if (file < 0 && errno == EEXIST) {
        file = shm_open(buffer, O_RDWR, 0);
        return file < 0 ? refused(result, result_of(errno)) : mapped(file, size, result, DUPLICATE);
    }
    if (file < 0) return refused(result, result_of(errno));
    if (ftruncate(file, (off_t)(rounding ? rounded_up(*size) : *size)) != 0) {
        close(file);
        return refused(result, result_of(errno));
    }
    return mapped(file, size, result, OK);
}

void *shim_shm_pointer(uint64_t handle, uint32_t *result) {
    uint32_t wanted = failure("SysSharedMemoryGetPointer");
    *result = handle == INVALID ? PARAMETER : wanted;
    return *result == OK ? ((mapping *)(uintptr_t)handle)->memory : NULL;
}

uint32_t shim_shm_close(uint64_t handle) {
    mapping *made = (mapping *)(uintptr_t)handle;
    if (handle == INVALID) return PARAMETER;
    munmap(made->memory, made->size);
    free(made);
    return OK;
}

uint64_t shim_sem_create(const char *name, uint32_t *result) {
    char buffer[256];
    uint32_t wanted = failure("SysSemProcessCreate");
    if (wanted) return refused(result, wanted);
    slashed(buffer, sizeof buffer, name);
    *result = OK;
    sem_t *made = sem_open(buffer, O_CREAT | O_EXCL, 0660, born);
    if (made == SEM_FAILED && errno == EEXIST) {
        *result = DUPLICATE;
        made = sem_open(buffer, 0);
    }
    return made == SEM_FAILED ? refused(result, result_of(errno)) : (uint64_t)(uintptr_t)made;
}

uint32_t shim_sem_enter(uint64_t handle, uint32_t timeout_ms) {
    sem_t *semaphore = (sem_t *)(uintptr_t)handle;
    struct timespec until;
    uint32_t wanted = failure("SysSemProcessEnter");
    if (handle == INVALID) return PARAMETER;
    if (wanted) return wanted;
    if (timeout_ms == 0) return sem_trywait(semaphore) == 0 ? OK : TIMEOUT;
    waits++;
    if (timeout_ms == UINT32_MAX) return sem_wait(semaphore) == 0 ? OK : FAILED;
    clock_gettime(CLOCK_REALTIME, &until);
    uint64_t ns = (uint64_t)until.tv_nsec + timeout_ms % 1000 * 1000000ull;
    until.tv_sec += timeout_ms / 1000 + (time_t)(ns / 1000000000);
    until.tv_nsec = (long)(ns % 1000000000);
    if (sem_timedwait(semaphore, &until) == 0) return OK;
    return errno == ETIMEDOUT ? TIMEOUT : FAILED;
}

uint32_t shim_sem_leave(uint64_t handle) {
    if (on_leave) on_leave();
    if (handle == INVALID) return PARAMETER;
    return sem_post((sem_t *)(uintptr_t)handle) == 0 ? OK : FAILED;
}

uint32_t shim_sem_delete(uint64_t handle) {
    uint32_t wanted = failure("SysSemProcessDelete");
    if (handle == INVALID) return PARAMETER;
    return wanted ? wanted : sem_close((sem_t *)(uintptr_t)handle) == 0 ? OK : FAILED;
}

static uint64_t ns_now(void) {
    struct timespec now;
    clock_gettime(CLOCK_MONOTONIC, &now);
    return (uint64_t)now.tv_sec * 1000000000u + (uint64_t)now.tv_nsec;
}

uint64_t shim_run(const shim_program *programs, uint64_t count, uint64_t period_ns, uint64_t cycles,
                  const char **reason) {
    uint64_t longest = 0, next = ns_now();
    for (*reason = NULL; cycles > 0 && *reason == NULL; cycles--) {
        uint64_t begun = ns_now();
        for (uint64_t index = 0; index < count && *reason == NULL; index++)
            *reason = programs[index].call(programs[index].self, NULL);
        uint64_t took = ns_now() - begun;
        longest = took > longest ? took : longest;
        next += period_ns;
        struct timespec until = {(time_t)(next / 1000000000u), (long)(next % 1000000000u)};
        clock_nanosleep(CLOCK_MONOTONIC, TIMER_ABSTIME, &until, NULL);
    }
    return longest;
}
