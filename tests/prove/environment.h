/* An environment with unknown values for the C headers. A peer may write any bytes at any time, so each access to a header
 * field returns any value, and payloads have any content. A system call fails with any error, or returns any valid result.
 * Two assumptions: the clock is below 2**33 s (the year 2242), and the size of a file stays the same after fstat(). */
#include "__fc_builtin.h"
#include <errno.h>
#include <fcntl.h>
#include <grp.h>
#include <pwd.h>
#include <sched.h>
#include <signal.h>
#include <stdbool.h>
#include <stdint.h>
#include <string.h>
#include <strings.h>
#include <sys/mman.h>
#include <sys/stat.h>
#include <time.h>
#include <unistd.h>

/* The headers access members of glibc's semaphore, so the type is that of glibc. */
#define __FC_SEMAPHORE
#define __GLIBC__ 2
#define __GLIBC_PREREQ(major, minor) 1
#define __USE_MISC
typedef union sem_t {
    char size[32];
    long __align;
} sem_t;
#define SEM_FAILED ((sem_t *)0)

#define CLOCK_LIMIT_S (INT64_C(1) << 33)

static volatile uint32_t any; /* Eva assumes an unknown value at each read of a volatile variable */
static volatile int any_int;
static volatile long any_long;

#define __atomic_load_n(address, order) (*(address), (__typeof__(*(address)))any)
#define __atomic_store_n(address, value, order) (*(address) = (value))
#define __atomic_fetch_add(address, value, order) (*(address), *(address) = (__typeof__(*(address)))any_long)
#define __atomic_fetch_sub(address, value, order) (*(address), *(address) = (__typeof__(*(address)))any_long)
#define __atomic_thread_fence(order) ((void)0)
#define __builtin_prefetch(address, writes) ((void)(address))
#define fcntl(file, command, request) any_record_lock(request)
#define syscall(...) any_long
#define sem_open(...) any_semaphore()
#define sem_close(semaphore) any_result()

static int any_result(void);
static sem_t *any_semaphore(void);
static int any_record_lock(struct flock *request);
int posix_fallocate(int file, off_t offset, off_t length);
int madvise(void *start, size_t length, int advice);
int sem_trywait(sem_t *semaphore);
int sem_post(sem_t *semaphore);

#include "shm_msgs/diagnostic_msgs/msg/diagnostic_array_shm.h"
#include "shm_msgs/std_srvs/srv/set_bool_service.h"

static int any_result(void)
{
    errno = any_int;
    return any ? -1 : 0;
}

static void *make_unknown(void *start, size_t size)
{
    Frama_C_make_unknown((char *)start, size);
    return start;
}

static int64_t any_between(int64_t minimum, int64_t maximum)
{
    int64_t number = any_long;
    return number < minimum ? minimum : number > maximum ? maximum : number;
}

int clock_gettime(clockid_t clock, struct timespec *now)
{
    now->tv_sec = any_between(0, CLOCK_LIMIT_S);
    now->tv_nsec = any_between(0, 999999999);
    return 0;
}

int nanosleep(const struct timespec *request, struct timespec *left)
{
    /*@ assert 0 <= request->tv_nsec <= 999999999 && request->tv_sec >= 0; */
    return any_result();
}

int sem_clockwait(sem_t *semaphore, clockid_t clock, const struct timespec *until)
{
    /*@ assert 0 <= until->tv_nsec <= 999999999 && until->tv_sec >= 0; */
    semaphore->__align = any_long;
    return any_result();
}

int sem_trywait(sem_t *semaphore)
{
    semaphore->__align = any_long;
    return any_result();
}

int sem_post(sem_t *semaphore)
{
    semaphore->__align = any_long;
    return any_result();
}

static sem_t semaphores[2];
static sem_t *any_semaphore(void)
{
    errno = any_int;
    return any ? &semaphores[any ? 0 : 1] : SEM_FAILED;
}

static int any_record_lock(struct flock *request)
{
    request->l_type = any ? F_UNLCK : F_WRLCK;
    return any_result();
}

int kill(pid_t process, int signal) { return any_result(); }
int fstat(int file, struct stat *status) { make_unknown(status, sizeof *status); return any_result(); }
int fchmod(int file, mode_t mode) { return any_result(); }
int fchown(int file, uid_t user, gid_t group) { return any_result(); }
int close(int file) { return any_result(); }
int sched_yield(void) { return any_result(); }
int madvise(void *start, size_t length, int advice) { return any_result(); }
int munmap(void *start, size_t length) { return any_result(); }
int shm_unlink(const char *name) { return any_result(); }
int posix_fallocate(int file, off_t offset, off_t length) { return any_int; }
pid_t getpid(void) { return (pid_t)any_between(1, INT32_MAX); }
gid_t getegid(void) { return any; }
uid_t geteuid(void) { return any; }

int shm_open(const char *name, int flags, mode_t mode)
{
    size_t length = strlen(name);
    /*@ assert 1 <= length <= 255; */
    errno = any_int;
    return any ? -1 : (int)any_between(0, INT32_MAX);
}

ssize_t pread(int file, void *buffer, size_t size, off_t offset)
{
    make_unknown(buffer, size);
    errno = any_int;
    return any_between(-1, (int64_t)size);
}

int getgroups(int max_count, gid_t groups[])
{
    make_unknown(groups, (size_t)max_count * sizeof *groups);
    return (int)any_between(-1, max_count);
}

int getgrnam_r(const char *name, struct group *entry, char *buffer, size_t size, struct group **result)
{
    make_unknown(buffer, size);
    entry->gr_gid = any;
    *result = any ? entry : NULL;
    return any_int;
}

int getpwuid_r(uid_t number, struct passwd *entry, char *buffer, size_t size, struct passwd **result)
{
    make_unknown(buffer, size);
    buffer[size - 1] = 0;
    entry->pw_gid = any;
    entry->pw_name = buffer;
    *result = any ? entry : NULL;
    return any_int;
}

/* The size is that of a region of the DiagnosticArray of eva.py with depth 1. */
static unsigned char region[12288] __attribute__((aligned(64)));
static unsigned char own_page[SHMGEN_PAGE], group_members[SHMGEN_MEMBERS];

void *mmap(void *address, size_t length, int protection, int flags, int file, off_t offset)
{
    if (any)
        return MAP_FAILED;
    if (file >= 0) {
        /*@ assert length <= sizeof(region); */
        return make_unknown(region, sizeof region);
    }
    if (length == sizeof own_page)
        return memset(own_page, 0, sizeof own_page);
    /*@ assert length == sizeof(group_members); */
    return make_unknown(group_members, sizeof group_members);
}

static bool any_bool(void)
{
    return any != 0;
}

/* Return a timeout in ns. A timeout of 0 means a single attempt. */
static int64_t any_timeout(void)
{
    return any_between(0, INT64_MAX);
}

/* Set the state that a link has after opening, with unknown values. */
static void set_open_state(shmgen_link *link, shmgen_type type, sem_t *lock)
{
    link->type = type;
    link->slots = 2;
    link->slot_size = (SHMGEN_SLOT_HEADER + type.size + SHMGEN_SLOT_STEP - 1) / SHMGEN_SLOT_STEP * SHMGEN_SLOT_STEP;
    link->size = SHMGEN_HEADER_SIZE + (uint64_t)SHMGEN_LANES * link->slots * link->slot_size;
    /*@ assert link->size <= sizeof(region); */
    make_unknown(region, sizeof region);
    link->base = region + sizeof region - link->size; /* Eva detects an access behind the array, so behind the region */
    own_page[0] = 1;
    link->mine = own_page;
    link->lock = lock;
    link->event = &semaphores[1];
    link->limit = SHMGEN_LOCK_MS * SHMGEN_MS;
    link->pid = any;
    link->seen = any;
    link->seen_count = any;
    link->seen_holder = any;
    link->holder_since = 0;
    link->step = SHMGEN_STEP_READY;
}
