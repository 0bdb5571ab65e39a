/* Whose files are used, and how those made here look: docs/deploy.md, "Whose files are used".
 *
 * Made by shmgen; changes made here are lost.
 */
#ifndef SHMGEN_ACCESS_H
#define SHMGEN_ACCESS_H

#include "shmgen_link.h"

#include <grp.h>
#include <pwd.h>

#ifdef __cplusplus
extern "C" {
#endif

/* User ids below are the machine's own services, which only root makes (Debian policy 9.2.2, SYS_UID_MAX). */
#define SHMGEN_FIRST_PERSON 1000

static inline mode_t shmgen_made_mode(const shmgen_link *link)
{
    return (mode_t)(link->mode != 0 ? link->mode : 0660);
}

/* The number of a group given by name or number; -1: there is none. */
static inline int64_t shmgen_group(const char *name)
{
    struct group entry, *found = NULL;
    char room[4096];
    int64_t number = 0;
    if (getgrnam_r(name, &entry, room, sizeof room, &found) == 0 && found != NULL)
        return (int64_t)found->gr_gid;
    for (const char *digit = name; *digit != 0; digit++) {
        if (*digit < '0' || *digit > '9' || number > INT64_C(0xFFFFFFFF))
            return -1;
        number = 10 * number + (*digit - '0');
    }
    return *name != 0 ? number : -1;
}

static inline bool shmgen_is_member(gid_t group)
{
    gid_t groups[256];
    int count = getgroups(256, groups);
    for (int index = 0; index < count; index++)
        if (groups[index] == group)
            return true;
    return group == getegid();
}

/* Whether this user has reason to trust the owner: himself, root, a service, or somebody with a group of his own. */
static inline bool shmgen_is_known(const struct stat *file)
{
    struct passwd user, *owner = NULL;
    struct group entry, *group = NULL;
    char room[4096], more[4096];
    if (file->st_uid < SHMGEN_FIRST_PERSON || file->st_uid == geteuid())
        return true;
    if (getpwuid_r(file->st_uid, &user, room, sizeof room, &owner) != 0 || owner == NULL)
        return false;
    if (getgrgid_r(file->st_gid, &entry, more, sizeof more, &group) != 0 || group == NULL)
        return false;
    if (owner->pw_gid != group->gr_gid || strcmp(owner->pw_name, group->gr_name) != 0)
        return false;
    return shmgen_is_member(group->gr_gid);
}

/* Whether nobody can write the file without leave. */
static inline bool shmgen_is_safe(const shmgen_link *link, int file)
{
    struct stat status;
    if ((link->mode & S_IWOTH) != 0)
        return true;
    if (fstat(file, &status) != 0 || (status.st_mode & S_IWOTH) != 0)
        return false;
    return (int64_t)status.st_gid == link->group || shmgen_is_known(&status);
}

/* Gives a file of this user's a mode, and the group that is wanted; one of somebody else's is left as it is. */
static inline bool shmgen_give(const shmgen_link *link, int file, mode_t mode)
{
    struct stat status;
    if (fstat(file, &status) != 0)
        return false;
    if (status.st_uid != geteuid())
        return true;
    if (link->group >= 0 && fchown(file, (uid_t)-1, (gid_t)link->group) != 0)
        return false;
    return fchmod(file, mode) == 0;
}

/* The same for one that is there, where it differs: who made it may have been killed before it gave it the mode. */
static inline bool shmgen_mend(const shmgen_link *link, int file)
{
    struct stat status;
    mode_t mode;
    if (fstat(file, &status) != 0)
        return false;
    mode = link->mode != 0 ? (mode_t)link->mode : (mode_t)(status.st_mode & 07777);
    if (mode == (status.st_mode & 07777) && (link->group < 0 || (int64_t)status.st_gid == link->group))
        return true;
    return shmgen_give(link, file, mode);
}

static inline bool shmgen_is_regular(int file)
{
    struct stat status;
    return fstat(file, &status) == 0 && S_ISREG(status.st_mode);
}

/* Whether a name of shared memory still leads to that file. */
static inline bool shmgen_leads_to(const char *name, int file)
{
    struct stat ours, theirs;
    int other = shm_open(name, O_RDWR | O_NOFOLLOW | O_NONBLOCK, 0);
    bool same = other >= 0 && fstat(other, &theirs) == 0 && fstat(file, &ours) == 0 && ours.st_dev == theirs.st_dev &&
                ours.st_ino == theirs.st_ino;
    if (other >= 0)
        close(other);
    return same;
}

/* As ftruncate, and takes the memory now: a full /dev/shm is an error here, not SIGBUS at the first store. */
static inline shmgen_status shmgen_allocate(int file, uint64_t size)
{
    int error;
    do
        error = posix_fallocate(file, 0, (off_t)size);
    while (error == EINTR);
    return error == 0 ? SHMGEN_OK : error == ENOSPC ? SHMGEN_REGION_NO_MEMORY : SHMGEN_REGION_OPEN_FAILED;
}

#ifdef __cplusplus
}
#endif

#endif
