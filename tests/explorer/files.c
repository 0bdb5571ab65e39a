/* Files and record locks, as the ends know them: regions and semaphores in /dev/shm.
 *
 * The linker takes these before the C library's. What opens a file is a step only where opening=1 says so.
 */
#define _GNU_SOURCE
#include "explorer.h"

#include "shmgen.h"

#include <errno.h>
#include <fcntl.h>
#include <semaphore.h>
#include <stdarg.h>
#include <stdio.h>
#include <string.h>
#include <sys/mman.h>
#include <sys/stat.h>

#define OPEN 12 /* descriptors of an actor */
#define FIRST 100
#define LOCKS 24

typedef struct inode {
    char name[64];
    int linked;
    int64_t size;
} inode;

static inode inodes[FILES];
static int8_t opened[ACTORS * OPEN]; /* 1 + inode, 0: a descriptor that is free */
static struct { int8_t file, byte, kind; } locks[LOCKS]; /* file: 1 + descriptor, 0: none */
static int inodes_count;

void files_reset(void)
{
    memset(inodes, 0, sizeof inodes);
    memset(opened, 0, sizeof opened);
    memset(locks, 0, sizeof locks);
    inodes_count = 0;
}

uint64_t files_hash(void)
{
    uint64_t hash = 0;
    for (int i = 0; i < inodes_count; i++)
        hash = mixed(hash, (uint64_t)(inodes[i].size * 2 + inodes[i].linked));
    for (int i = 0; i < LOCKS; i++) /* in whatever order they came */
        hash += locks[i].file != 0 ? mixed(1, (uint64_t)(locks[i].file * 4096 + locks[i].byte * 16 + locks[i].kind)) : 0;
    return hash;
}

static bool has_locks(int file)
{
    bool found = false;
    for (int i = 0; i < LOCKS; i++)
        found = found || locks[i].file == file - FIRST + 1;
    return found;
}

static void forget_locks(int file)
{
    for (int i = 0; i < LOCKS; i++)
        if (locks[i].file == file - FIRST + 1)
            locks[i].file = 0;
}

void close_all(int actor)
{
    for (int file = actor * OPEN; file < (actor + 1) * OPEN; file++) {
        forget_locks(FIRST + file);
        opened[file] = 0;
    }
}

/* Which file, and what of it. */
const char *name_of(const void *at)
{
    static char texts[4][64];
    static int last;
    static const struct { size_t at; const char *name; } words[] = {
#define WORD(name) {offsetof(shmgen_region, name), #name}
        WORD(magic), WORD(writer), WORD(completed0), WORD(completed1), WORD(turn), WORD(left), WORD(heartbeat),
        WORD(lock_holder), WORD(recoveries), WORD(armed), WORD(lock_count), WORD(missed), WORD(bell)};
    char *text = texts[++last & 3];
    const size_t offset = (size_t)((const unsigned char *)at - files[0]), file = offset / FILE_SIZE, place = offset % FILE_SIZE;
    const uint32_t slot_size = (uint32_t)get(files[file] + offsetof(shmgen_region, slot_size), 4);
    const char *of = inodes[file].name;
    if (strncmp(of, "/sem.", 5) == 0) {
        snprintf(text, 64, "%s", strstr(of, "-event") ? "the event" : "the lock");
        return text;
    }
    of = strchr(of, '-') ? strchr(of, '-') : "";
    for (size_t i = 0; i < sizeof words / sizeof *words; i++)
        if (words[i].at == place) {
            snprintf(text, 64, "%s%s%s", words[i].name, *of ? " of " : "", *of ? of + 1 : "");
            return text;
        }
    if (place >= sizeof(shmgen_region) && slot_size != 0) {
        const size_t slot = (place - sizeof(shmgen_region)) / slot_size, within = (place - sizeof(shmgen_region)) % slot_size;
        if (within == offsetof(shmgen_slot, number))
            snprintf(text, 64, "slot%zu.number%s", slot, of);
        else
            snprintf(text, 64, "slot%zu+%zu%s", slot, within, of);
    } else {
        snprintf(text, 64, "+%zu%s", place, of);
    }
    return text;
}

/* --- calls -------------------------------------------------------------------------------------------------- */

static void opening_step(void)
{
    if (told("opening", 0))
        step();
}

static int find_inode(const char *name)
{
    for (int i = 0; i < inodes_count; i++)
        if (inodes[i].linked && strcmp(inodes[i].name, name) == 0)
            return i;
    return -1;
}

static int make_inode(const char *name, int64_t size)
{
    if (inodes_count == FILES)
        fail("more than %d files", FILES);
    snprintf(inodes[inodes_count].name, sizeof inodes[0].name, "%s", name);
    inodes[inodes_count].linked = 1;
    inodes[inodes_count].size = size;
    return inodes_count++;
}

static inode *inode_of(int file)
{
    return &inodes[opened[file - FIRST] - 1];
}

static int answer(int result, int error)
{
    saw('o', NULL, (uint64_t)(result * 1000 + error));
    errno = error;
    return result;
}

int shm_open(const char *name, int flags, mode_t mode)
{
    int found, file = self * OPEN;
    (void)mode;
    opening_step();
    found = find_inode(name);
    if (told("opening", 0))
        say("opens %s%s: %s", name, flags & O_CREAT ? " anew" : "", found < 0 ? "not there" : "there");
    if (found < 0 && !(flags & O_CREAT))
        return answer(-1, ENOENT);
    if (found >= 0 && flags & O_EXCL)
        return answer(-1, EEXIST);
    if (found < 0)
        found = make_inode(name, 0);
    while (file < (self + 1) * OPEN && opened[file] != 0)
        file++;
    if (file == (self + 1) * OPEN)
        fail("more than %d descriptors", OPEN);
    opened[file] = (int8_t)(found + 1);
    return answer(FIRST + file, 0);
}

int shm_unlink(const char *name)
{
    int found;
    opening_step();
    found = find_inode(name);
    if (found >= 0)
        inodes[found].linked = 0;
    return answer(found >= 0 ? 0 : -1, ENOENT);
}

int close(int file)
{
    if (has_locks(file) || told("opening", 0))
        step();
    forget_locks(file);
    opened[file - FIRST] = 0;
    return 0;
}

int fstat(int file, struct stat *status)
{
    opening_step();
    memset(status, 0, sizeof *status);
    status->st_mode = S_IFREG | 0660;
    status->st_size = inode_of(file)->size;
    status->st_nlink = (nlink_t)inode_of(file)->linked;
    status->st_ino = (ino_t)(inode_of(file) - inodes + 1);
    answer((int)status->st_size, (int)(status->st_nlink * 16 + status->st_ino));
    return 0;
}

int fchmod(int file, mode_t mode)
{
    (void)file, (void)mode;
    return 0;
}

int posix_fallocate(int file, off_t at, off_t size)
{
    opening_step();
    inode_of(file)->size = at + size;
    return 0;
}

int ftruncate(int file, off_t size)
{
    return posix_fallocate(file, 0, size);
}

ssize_t pread(int file, void *data, size_t size, off_t at)
{
    const inode *from = inode_of(file);
    uint64_t hash = 0;
    opening_step();
    if (at >= from->size)
        return 0;
    if ((int64_t)size > from->size - at)
        size = (size_t)(from->size - at);
    memcpy(data, files[from - inodes] + at, size);
    for (size_t i = 0; i < size; i++)
        hash = mixed(hash, ((unsigned char *)data)[i]);
    saw('o', NULL, hash);
    return (ssize_t)size;
}

ssize_t pwrite(int file, const void *data, size_t size, off_t at)
{
    opening_step();
    put(files[inode_of(file) - inodes] + at, get(data, (int)size), (int)size);
    say("writes %llx at %d", (unsigned long long)get(data, (int)size), (int)at);
    return (ssize_t)size;
}

void *mmap(void *address, size_t size, int protection, int flags, int file, off_t at)
{
    (void)address, (void)size, (void)protection, (void)at;
    return flags & MAP_ANONYMOUS ? MAP_FAILED : files[inode_of(file) - inodes];
}

int munmap(void *address, size_t size)
{
    (void)address, (void)size;
    return 0;
}

sem_t *sem_open(const char *name, int flags, ...)
{
    char file[64];
    int found;
    unsigned value = 0;
    va_list values;
    snprintf(file, sizeof file, "/sem.%s", name + 1);
    opening_step();
    found = find_inode(file);
    if (found < 0 && !(flags & O_CREAT))
        return answer(-1, ENOENT), SEM_FAILED;
    if (found >= 0 && flags & O_EXCL)
        return answer(-1, EEXIST), SEM_FAILED;
    if (found < 0) {
        va_start(values, flags);
        (void)va_arg(values, unsigned);
        value = va_arg(values, unsigned);
        va_end(values);
        found = make_inode(file, sizeof(sem_t));
        put(files[found], value, 4);
    }
    answer(found, 0);
    return (sem_t *)(void *)files[found];
}

int sem_close(sem_t *semaphore)
{
    (void)semaphore;
    return 0;
}

/* --- record locks, of the open-file kind ------------------------------------------------------------------- */

static bool excludes(int lock, int file, const struct flock *asked)
{
    return locks[lock].file != 0 && locks[lock].file != file - FIRST + 1 && locks[lock].byte == asked->l_start &&
           opened[locks[lock].file - 1] == opened[file - FIRST] && (asked->l_type == F_WRLCK || locks[lock].kind == F_WRLCK);
}

int fcntl(int file, int command, ...)
{
    struct flock *asked;
    va_list values;
    bool free = true;
    int mine = -1;
    va_start(values, command);
    asked = va_arg(values, struct flock *);
    va_end(values);
    step();
    let_out(self);
    for (int i = LOCKS; i-- > 0;) {
        free = free && !excludes(i, file, asked);
        if (locks[i].file == file - FIRST + 1 && locks[i].byte == asked->l_start)
            mine = i;
        else if (locks[i].file == 0 && (mine < 0 || locks[mine].file == 0))
            mine = i;
    }
    say("record lock %d %s: %s", (int)asked->l_start, asked->l_type == F_UNLCK ? "off" : "on", free ? "done" : "held by another");
    if (command == F_OFD_GETLK)
        asked->l_type = free ? F_UNLCK : F_WRLCK;
    else if (asked->l_type == F_UNLCK)
        locks[mine].file = 0;
    else if (free)
        locks[mine].file = (int8_t)(file - FIRST + 1), locks[mine].byte = (int8_t)asked->l_start,
        locks[mine].kind = (int8_t)asked->l_type;
    return answer(free || command == F_OFD_GETLK ? 0 : -1, free ? 0 : EAGAIN);
}
