/* The headers in a world of which nothing is known. A peer writes into a region what and when it likes, so each look at a
 * word of it gives any value, and its payloads hold anything; a system call fails with any error, or gives whatever it may.
 * Assumed: the clock is below 2**33 s (the year 2242), and a file keeps the size that it was seen to have. */
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

/* As glibc has it, whose inside the headers look at. */
#define __FC_SEMAPHORE
#define __GLIBC__ 2
#define __GLIBC_PREREQ(major, minor) 1
#define __USE_MISC
typedef union sem_t {
    char size[32];
    long __align;
} sem_t;
#define SEM_FAILED ((sem_t *)0)

#define SHMGEN_END (INT64_C(1) << 33)

static volatile uint32_t any;
static volatile int any_int;
static volatile long any_long;

#define __atomic_load_n(p, order) (*(p), (__typeof__(*(p)))any)
#define __atomic_store_n(p, value, order) (*(p) = (value))
#define __atomic_fetch_add(p, value, order) (*(p), *(p) = (__typeof__(*(p)))any_long)
#define __atomic_fetch_sub(p, value, order) (*(p), *(p) = (__typeof__(*(p)))any_long)
#define __atomic_thread_fence(order) ((void)0)
#define __builtin_prefetch(p, writes) ((void)(p))
#define fcntl(file, command, asked) given_lock(asked)
#define syscall(...) any_long
#define sem_open(...) given_semaphore()
#define sem_close(semaphore) answer()

static int answer(void);
static sem_t *given_semaphore(void);
static int given_lock(struct flock *asked);
int posix_fallocate(int file, off_t offset, off_t length);
int madvise(void *start, size_t length, int advice);
int sem_trywait(sem_t *semaphore);
int sem_post(sem_t *semaphore);

#include "shm_msgs/diagnostic_msgs/msg/diagnostic_array_shm.h"
#include "shm_msgs/std_srvs/srv/set_bool_service.h"

static int answer(void)
{
    errno = any_int;
    return any ? -1 : 0;
}

static void *given(void *start, size_t size)
{
    Frama_C_make_unknown((char *)start, size);
    return start;
}

static int64_t between(int64_t least, int64_t most)
{
    int64_t number = any_long;
    return number < least ? least : number > most ? most : number;
}

int clock_gettime(clockid_t clock, struct timespec *now)
{
    now->tv_sec = between(0, SHMGEN_END);
    now->tv_nsec = between(0, 999999999);
    return 0;
}

int nanosleep(const struct timespec *asked, struct timespec *left)
{
    /*@ assert 0 <= asked->tv_nsec <= 999999999 && asked->tv_sec >= 0; */
    return answer();
}

int sem_clockwait(sem_t *semaphore, clockid_t clock, const struct timespec *until)
{
    /*@ assert 0 <= until->tv_nsec <= 999999999 && until->tv_sec >= 0; */
    semaphore->__align = any_long;
    return answer();
}

int sem_trywait(sem_t *semaphore)
{
    semaphore->__align = any_long;
    return answer();
}

int sem_post(sem_t *semaphore)
{
    semaphore->__align = any_long;
    return answer();
}

static sem_t semaphores[2];
static sem_t *given_semaphore(void)
{
    errno = any_int;
    return any ? &semaphores[any ? 0 : 1] : SEM_FAILED;
}

static int given_lock(struct flock *asked)
{
    asked->l_type = any ? F_UNLCK : F_WRLCK;
    return answer();
}

int kill(pid_t process, int signal) { return answer(); }
int fstat(int file, struct stat *status) { given(status, sizeof *status); return answer(); }
int fchmod(int file, mode_t mode) { return answer(); }
int fchown(int file, uid_t user, gid_t group) { return answer(); }
int close(int file) { return answer(); }
int sched_yield(void) { return answer(); }
int madvise(void *start, size_t length, int advice) { return answer(); }
int munmap(void *start, size_t length) { return answer(); }
int shm_unlink(const char *name) { return answer(); }
int posix_fallocate(int file, off_t offset, off_t length) { return any_int; }
pid_t getpid(void) { return (pid_t)between(1, INT32_MAX); }
gid_t getegid(void) { return any; }
uid_t geteuid(void) { return any; }

int shm_open(const char *name, int how, mode_t mode)
{
    size_t length = strlen(name);
    /*@ assert 1 <= length <= 255; */
    errno = any_int;
    return any ? -1 : (int)between(0, INT32_MAX);
}

ssize_t pread(int file, void *into, size_t size, off_t at)
{
    given(into, size);
    errno = any_int;
    return between(-1, (int64_t)size);
}

int getgroups(int most, gid_t groups[])
{
    given(groups, (size_t)most * sizeof *groups);
    return (int)between(-1, most);
}

int getgrnam_r(const char *name, struct group *entry, char *room, size_t size, struct group **found)
{
    given(room, size);
    entry->gr_gid = any;
    *found = any ? entry : NULL;
    return any_int;
}

int getpwuid_r(uid_t number, struct passwd *entry, char *room, size_t size, struct passwd **found)
{
    given(room, size);
    room[size - 1] = 0;
    entry->pw_gid = any;
    entry->pw_name = room;
    *found = any ? entry : NULL;
    return any_int;
}

/* As large as the region of the Array with depth 1. */
static unsigned char region[12288] __attribute__((aligned(64)));
static unsigned char page[SHMGEN_PAGE], members[SHMGEN_MEMBERS];

void *mmap(void *at, size_t length, int what, int how, int file, off_t offset)
{
    if (any)
        return MAP_FAILED;
    if (file >= 0) {
        /*@ assert length <= sizeof(region); */
        return given(region, sizeof region);
    }
    if (length == sizeof page)
        return memset(page, 0, sizeof page);
    /*@ assert length == sizeof(members); */
    return given(members, sizeof members);
}

static bool some(void)
{
    return any != 0;
}

/* 0, which is one try, or a time to wait. */
static int64_t limit(void)
{
    return between(0, INT64_MAX);
}

/* An end as opening leaves it. */
static void opened(shmgen_link *end, shmgen_type type, sem_t *lock)
{
    end->type = type;
    end->slots = 2;
    end->slot_size = (SHMGEN_SLOT_HEADER + type.size + SHMGEN_SLOT_STEP - 1) / SHMGEN_SLOT_STEP * SHMGEN_SLOT_STEP;
    end->size = SHMGEN_HEADER_SIZE + (uint64_t)SHMGEN_LANES * end->slots * end->slot_size;
    /*@ assert end->size <= sizeof(region); */
    given(region, sizeof region);
    end->base = region + sizeof region - end->size; /* nothing lies behind it */
    page[0] = 1;
    end->mine = page;
    end->lock = lock;
    end->event = &semaphores[1];
    end->limit = SHMGEN_LOCK_MS * SHMGEN_MS;
    end->pid = any;
    end->seen = any;
    end->seen_count = any;
    end->seen_holder = any;
    end->holder_since = 0;
    end->step = SHMGEN_STEP_READY;
}
