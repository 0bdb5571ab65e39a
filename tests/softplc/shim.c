/* Implements shim.h. */
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

static unsigned initial_value = 1;
static int rounds_sizes = 0;
static uint32_t stopped_at, enter_waits;
static int is_clock_stopped = 0;
static void (*on_leave)(void);
static struct {
    char function[32];
    uint32_t result;
} planned;

void shim_set_initial_value(unsigned value) { initial_value = value; }
void shim_round_sizes(int rounded) { rounds_sizes = rounded; }
uint32_t shim_waits(void) { return enter_waits; }
void shim_on_leave(void (*call)(void)) { on_leave = call; }

void shim_fail(const char *function, uint32_t result) {
    snprintf(planned.function, sizeof planned.function, "%s", function);
    planned.result = result;
}

void shim_stop_clock(uint32_t ms) {
    stopped_at = ms;
    is_clock_stopped = 1;
}

void shim_restart_clock(void) { is_clock_stopped = 0; }

uint32_t shim_now(void) {
    struct timespec now;
    if (is_clock_stopped) return stopped_at;
    clock_gettime(CLOCK_MONOTONIC, &now);
    return (uint32_t)(now.tv_sec * 1000ull + now.tv_nsec / 1000000);
}

static uint32_t planned_result(const char *function) {
    return strcmp(planned.function, function) == 0 ? planned.result : OK;
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

static const char *with_slash(char *buffer, size_t size, const char *name) {
    snprintf(buffer, size, "%s%s", name[0] == '/' ? "" : "/", name);
    return buffer;
}

static uint64_t fail_with(uint32_t *result, uint32_t error) {
    *result = error;
    return INVALID;
}

static uint64_t rounded_up(uint64_t size) { return (size + PAGE - 1) / PAGE * PAGE; }

static uint64_t map_and_close(int file, uint64_t *size, uint32_t *result, uint32_t success) {
    struct stat status;
    mapping *new_mapping;
    fstat(file, &status);
    uint64_t file_size = (uint64_t)status.st_size;
    if (file_size != (rounds_sizes ? rounded_up(*size) : *size) || file_size == 0) {
        close(file);
        *size = file_size;
        return fail_with(result, BUFFERSIZE);
    }
    new_mapping = malloc(sizeof *new_mapping);
    new_mapping->size = file_size;
    new_mapping->memory = mmap(NULL, file_size, PROT_READ | PROT_WRITE, MAP_SHARED, file, 0);
    close(file);
    if (new_mapping->memory == MAP_FAILED) {
        free(new_mapping);
        return fail_with(result, NOMEMORY);
    }
    *result = success;
    return (uint64_t)(uintptr_t)new_mapping;
}

uint64_t shim_shm_open(const char *name, uint64_t address, uint64_t *size, uint32_t *result) {
    char buffer[256];
    uint32_t planned_failure = planned_result("SysSharedMemoryOpen2");
    if (planned_failure) return fail_with(result, planned_failure);
    if (address != 0) return fail_with(result, PARAMETER);
    int file = shm_open(with_slash(buffer, sizeof buffer, name), O_RDWR, 0);
    return file < 0 ? fail_with(result, result_of(errno)) : map_and_close(file, size, result, OK);
}

uint64_t shim_shm_create(const char *name, uint64_t address, uint64_t *size, uint32_t *result) {
    char buffer[256];
    uint32_t planned_failure = planned_result("SysSharedMemoryCreate");
    if (planned_failure) return fail_with(result, planned_failure);
    if (address != 0) return fail_with(result, PARAMETER);
    int file = shm_open(with_slash(buffer, sizeof buffer, name), O_RDWR | O_CREAT | O_EXCL, 0660);
    if (file < 0 && errno == EEXIST) {
        file = shm_open(buffer, O_RDWR, 0);
        return file < 0 ? fail_with(result, result_of(errno)) : map_and_close(file, size, result, DUPLICATE);
    }
    if (file < 0) return fail_with(result, result_of(errno));
    if (ftruncate(file, (off_t)(rounds_sizes ? rounded_up(*size) : *size)) != 0) {
        close(file);
        return fail_with(result, result_of(errno));
    }
    return map_and_close(file, size, result, OK);
}

void *shim_shm_pointer(uint64_t handle, uint32_t *result) {
    uint32_t planned_failure = planned_result("SysSharedMemoryGetPointer");
    *result = handle == INVALID ? PARAMETER : planned_failure;
    return *result == OK ? ((mapping *)(uintptr_t)handle)->memory : NULL;
}

uint32_t shim_shm_close(uint64_t handle) {
    mapping *open_mapping = (mapping *)(uintptr_t)handle;
    if (handle == INVALID) return PARAMETER;
    munmap(open_mapping->memory, open_mapping->size);
    free(open_mapping);
    return OK;
}

uint64_t shim_sem_create(const char *name, uint32_t *result) {
    char buffer[256];
    uint32_t planned_failure = planned_result("SysSemProcessCreate");
    if (planned_failure) return fail_with(result, planned_failure);
    with_slash(buffer, sizeof buffer, name);
    *result = OK;
    sem_t *semaphore = sem_open(buffer, O_CREAT | O_EXCL, 0660, initial_value);
    if (semaphore == SEM_FAILED && errno == EEXIST) {
        *result = DUPLICATE;
        semaphore = sem_open(buffer, 0);
    }
    return semaphore == SEM_FAILED ? fail_with(result, result_of(errno)) : (uint64_t)(uintptr_t)semaphore;
}

uint32_t shim_sem_enter(uint64_t handle, uint32_t timeout_ms) {
    sem_t *semaphore = (sem_t *)(uintptr_t)handle;
    struct timespec deadline;
    uint32_t planned_failure = planned_result("SysSemProcessEnter");
    if (handle == INVALID) return PARAMETER;
    if (planned_failure) return planned_failure;
    if (timeout_ms == 0) return sem_trywait(semaphore) == 0 ? OK : TIMEOUT;
    enter_waits++;
    if (timeout_ms == UINT32_MAX) return sem_wait(semaphore) == 0 ? OK : FAILED;
    clock_gettime(CLOCK_REALTIME, &deadline);
    uint64_t ns = (uint64_t)deadline.tv_nsec + timeout_ms % 1000 * 1000000ull;
    deadline.tv_sec += timeout_ms / 1000 + (time_t)(ns / 1000000000);
    deadline.tv_nsec = (long)(ns % 1000000000);
    if (sem_timedwait(semaphore, &deadline) == 0) return OK;
    return errno == ETIMEDOUT ? TIMEOUT : FAILED;
}

uint32_t shim_sem_leave(uint64_t handle) {
    if (on_leave) on_leave();
    if (handle == INVALID) return PARAMETER;
    return sem_post((sem_t *)(uintptr_t)handle) == 0 ? OK : FAILED;
}

uint32_t shim_sem_delete(uint64_t handle) {
    uint32_t planned_failure = planned_result("SysSemProcessDelete");
    if (handle == INVALID) return PARAMETER;
    return planned_failure ? planned_failure : sem_close((sem_t *)(uintptr_t)handle) == 0 ? OK : FAILED;
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
        uint64_t started_at = ns_now();
        for (uint64_t index = 0; index < count && *reason == NULL; index++)
            *reason = programs[index].call(programs[index].self, NULL);
        uint64_t duration = ns_now() - started_at;
        longest = duration > longest ? duration : longest;
        next += period_ns;
        struct timespec deadline = {(time_t)(next / 1000000000u), (long)(next % 1000000000u)};
        clock_nanosleep(CLOCK_MONOTONIC, TIMER_ABSTIME, &deadline, NULL);
    }
    return longest;
}
