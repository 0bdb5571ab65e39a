/* Simulated files and record locks: the regions and semaphores in /dev/shm.
 *
 * The linker prefers these functions to those of the C library. Opening a file is a step only if opening=1 is set.
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

#define DESCRIPTORS 12 /* for each actor */
#define FIRST_FD 100
#define LOCKS 24

typedef struct inode {
    char name[64];
    int linked;
    int64_t size;
} inode;

static inode inodes[FILES];
static int8_t descriptors[ACTORS * DESCRIPTORS]; /* 1 + inode; 0: unused */
static struct { int8_t file, byte, kind; } locks[LOCKS]; /* file: 1 + descriptor; 0: unused */
static int inodes_count;

void files_reset(void)
{
    memset(inodes, 0, sizeof inodes);
    memset(descriptors, 0, sizeof descriptors);
    memset(locks, 0, sizeof locks);
    inodes_count = 0;
}

uint64_t files_hash(void)
{
    uint64_t hash = 0;
    for (int i = 0; i < inodes_count; i++)
        hash = mix(hash, (uint64_t)(inodes[i].size * 2 + inodes[i].linked));
    for (int i = 0; i < LOCKS; i++) /* independent of the order of acquisition */
        hash += locks[i].file != 0 ? mix(1, (uint64_t)(locks[i].file * 4096 + locks[i].byte * 16 + locks[i].kind)) : 0;
    return hash;
}

static bool has_locks(int file)
{
    bool has_lock = false;
    for (int i = 0; i < LOCKS; i++)
        has_lock = has_lock || locks[i].file == file - FIRST_FD + 1;
    return has_lock;
}

static void forget_locks(int file)
{
    for (int i = 0; i < LOCKS; i++)
        if (locks[i].file == file - FIRST_FD + 1)
            locks[i].file = 0;
}

void close_all(int actor)
{
    for (int file = actor * DESCRIPTORS; file < (actor + 1) * DESCRIPTORS; file++) {
        forget_locks(FIRST_FD + file);
        descriptors[file] = 0;
    }
}

/* Return the name of a header field, slot or semaphore, for the printed steps. */
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

/* --- system calls -------------------------------------------------------------------------------------------------- */

static void opening_step(void)
{
    if (setting("opening", 0))
        step();
}

static int find_inode(const char *name)
{
    for (int i = 0; i < inodes_count; i++)
        if (inodes[i].linked && strcmp(inodes[i].name, name) == 0)
            return i;
    return -1;
}

static int create_inode(const char *name, int64_t size)
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
    return &inodes[descriptors[file - FIRST_FD] - 1];
}

static int return_with(int result, int error)
{
    observe('o', NULL, (uint64_t)(result * 1000 + error));
    errno = error;
    return result;
}

int shm_open(const char *name, int flags, mode_t mode)
{
    int index, file = self * DESCRIPTORS;
    (void)mode;
    opening_step();
    index = find_inode(name);
    if (setting("opening", 0))
        trace("opens %s%s: %s", name, flags & O_CREAT ? " or creates" : "", index < 0 ? "missing" : "exists");
    if (index < 0 && !(flags & O_CREAT))
        return return_with(-1, ENOENT);
    if (index >= 0 && flags & O_EXCL)
        return return_with(-1, EEXIST);
    if (index < 0)
        index = create_inode(name, 0);
    while (file < (self + 1) * DESCRIPTORS && descriptors[file] != 0)
        file++;
    if (file == (self + 1) * DESCRIPTORS)
        fail("more than %d descriptors", DESCRIPTORS);
    descriptors[file] = (int8_t)(index + 1);
    return return_with(FIRST_FD + file, 0);
}

int shm_unlink(const char *name)
{
    int index;
    opening_step();
    index = find_inode(name);
    if (index >= 0)
        inodes[index].linked = 0;
    return return_with(index >= 0 ? 0 : -1, ENOENT);
}

int close(int file)
{
    if (has_locks(file) || setting("opening", 0))
        step();
    forget_locks(file);
    descriptors[file - FIRST_FD] = 0;
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
    return_with((int)status->st_size, (int)(status->st_nlink * 16 + status->st_ino));
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
        hash = mix(hash, ((unsigned char *)data)[i]);
    observe('o', NULL, hash);
    return (ssize_t)size;
}

ssize_t pwrite(int file, const void *data, size_t size, off_t at)
{
    opening_step();
    put(files[inode_of(file) - inodes] + at, get(data, (int)size), (int)size);
    trace("writes %llx at %d", (unsigned long long)get(data, (int)size), (int)at);
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
    int index;
    unsigned value = 0;
    va_list values;
    snprintf(file, sizeof file, "/sem.%s", name + 1);
    opening_step();
    index = find_inode(file);
    if (index < 0 && !(flags & O_CREAT))
        return return_with(-1, ENOENT), SEM_FAILED;
    if (index >= 0 && flags & O_EXCL)
        return return_with(-1, EEXIST), SEM_FAILED;
    if (index < 0) {
        va_start(values, flags);
        (void)va_arg(values, unsigned);
        value = va_arg(values, unsigned);
        va_end(values);
        index = create_inode(file, sizeof(sem_t));
        put(files[index], value, 4);
    }
    return_with(index, 0);
    return (sem_t *)(void *)files[index];
}

int sem_close(sem_t *semaphore)
{
    (void)semaphore;
    return 0;
}

/* --- open-file record locks -------------------------------------------------------------------------------- */

static bool excludes(int lock, int file, const struct flock *requested)
{
    return locks[lock].file != 0 && locks[lock].file != file - FIRST_FD + 1 && locks[lock].byte == requested->l_start &&
           descriptors[locks[lock].file - 1] == descriptors[file - FIRST_FD] &&
           (requested->l_type == F_WRLCK || locks[lock].kind == F_WRLCK);
}

int fcntl(int file, int command, ...)
{
    struct flock *requested;
    va_list values;
    bool free = true;
    int slot = -1;
    va_start(values, command);
    requested = va_arg(values, struct flock *);
    va_end(values);
    step();
    flush_stores(self);
    for (int i = LOCKS; i-- > 0;) {
        free = free && !excludes(i, file, requested);
        if (locks[i].file == file - FIRST_FD + 1 && locks[i].byte == requested->l_start)
            slot = i;
        else if (locks[i].file == 0 && (slot < 0 || locks[slot].file == 0))
            slot = i;
    }
    trace("record lock %d %s: %s", (int)requested->l_start, requested->l_type == F_UNLCK ? "off" : "on",
        free ? "done" : "held by another actor");
    if (command == F_OFD_GETLK)
        requested->l_type = free ? F_UNLCK : F_WRLCK;
    else if (requested->l_type == F_UNLCK)
        locks[slot].file = 0;
    else if (free)
        locks[slot].file = (int8_t)(file - FIRST_FD + 1), locks[slot].byte = (int8_t)requested->l_start,
        locks[slot].kind = (int8_t)requested->l_type;
    return return_with(free || command == F_OFD_GETLK ? 0 : -1, free ? 0 : EAGAIN);
}
