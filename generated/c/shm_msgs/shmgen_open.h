/* Opens a topic's region and its semaphores, or makes what is missing, step by step: no step waits.
 *
 * Made by shmgen; changes made here are lost.
 */
#ifndef SHMGEN_OPEN_H
#define SHMGEN_OPEN_H

#include "shmgen_access.h"
#include "shmgen_lock.h"

#ifdef __cplusplus
extern "C" {
#endif

/* Another maker of the same header has written his after so many ns. */
#define SHMGEN_OTHER_MAKER (2 * SHMGEN_MS)
/* Characters that a file name leaves a region: 255 less those of "sem." and "-event". */
#define SHMGEN_LONGEST 245

static inline bool shmgen_is_half(const char *half)
{
    return strcmp(half, "request") == 0 || strcmp(half, "response") == 0 || strcmp(half, "goal") == 0 ||
           strcmp(half, "feedback") == 0 || strcmp(half, "result") == 0;
}

/* "/robot/pose" -> "/robot.pose", "/cell/start-request" -> "/cell.start-request". */
static inline shmgen_status shmgen_name_region(shmgen_link *link, const char *topic)
{
    char before = '/';
    size_t length = 1;
    link->name[0] = '/';
    if (*topic == '/')
        topic++;
    if (*topic == 0)
        return SHMGEN_TOPIC_EMPTY;
    for (; *topic != 0 && *topic != '-'; before = *topic++) {
        bool letter = (*topic >= 'a' && *topic <= 'z') || (*topic >= 'A' && *topic <= 'Z') || *topic == '_';
        bool inside = before != '/' && (*topic == '/' || (*topic >= '0' && *topic <= '9'));
        if (!letter && !inside)
            return SHMGEN_TOPIC_INVALID;
        if (length > SHMGEN_LONGEST)
            return SHMGEN_TOPIC_TOO_LONG;
        link->name[length++] = (char)(*topic == '/' ? '.' : *topic);
    }
    if (before == '/' || (*topic == '-' && !shmgen_is_half(topic + 1)))
        return SHMGEN_TOPIC_INVALID;
    link->name[length] = 0;
    if (strncmp(link->name, "/sem.", 5) == 0) /* where Linux keeps the semaphores */
        return SHMGEN_TOPIC_INVALID;
    if (length + strlen(topic) > SHMGEN_LONGEST + 1)
        return SHMGEN_TOPIC_TOO_LONG;
    memcpy(link->name + length, topic, strlen(topic) + 1);
    return SHMGEN_OK;
}

/* Takes the settings over; shmgen_link_step() then opens the region. */
static inline shmgen_status shmgen_link_start(
    shmgen_link *link, const char *topic, const shmgen_type *type, const shmgen_options *options)
{
    uint32_t depth = options != NULL && options->depth != 0 ? options->depth : 1;
    uint32_t limit = options != NULL && options->lock_us != 0 ? options->lock_us : SHMGEN_LOCK_MS * 1000;
    const char *group = options != NULL && options->group != NULL ? options->group : type->group;
    shmgen_status status;
    memset(link, 0, sizeof *link);
    link->file = -1;
    link->type = *type;
    link->mode = options != NULL && options->mode != 0 ? options->mode : type->mode;
    link->group = group != NULL && *group != 0 ? shmgen_group(group) : -1;
    link->limit = (int64_t)limit * 1000;
    link->pid = (uint32_t)getpid();
    status = shmgen_name_region(link, topic);
    if (status != SHMGEN_OK)
        return status;
    if (depth > SHMGEN_MAX_DEPTH)
        return SHMGEN_DEPTH_INVALID;
    if (limit > 1000000)
        return SHMGEN_LIMIT_INVALID;
    if (group != NULL && *group != 0 && link->group < 0)
        return SHMGEN_GROUP_UNKNOWN;
    if (type->sequence != 0 && !SHMGEN_KEEPS_ORDER)
        return SHMGEN_NEEDS_LOCK;
    for (link->slots = 2; link->slots <= depth;)
        link->slots *= 2;
    link->slot_size = (SHMGEN_SLOT_HEADER + type->size + SHMGEN_SLOT_STEP - 1) / SHMGEN_SLOT_STEP * SHMGEN_SLOT_STEP;
    link->size = SHMGEN_HEADER_SIZE + (uint64_t)link->slots * link->slot_size;
    link->size = (link->size + SHMGEN_PAGE - 1) / SHMGEN_PAGE * SHMGEN_PAGE;
    shmgen_go(link, SHMGEN_STEP_FILE);
    return SHMGEN_OK;
}

/* Lets go of everything; the region stays for the other side. */
static inline void shmgen_link_close(shmgen_link *link)
{
    if (link->base != NULL)
        munmap(link->base, (size_t)link->size);
    if (link->mine != NULL)
        munmap(link->mine, SHMGEN_PAGE);
    if (link->lock != NULL)
        sem_close(link->lock);
    if (link->event != NULL)
        sem_close(link->event);
    if (link->step != SHMGEN_STEP_CLOSED && link->file >= 0)
        close(link->file);
    link->base = link->mine = NULL;
    link->lock = link->event = NULL;
    link->file = -1;
    link->step = SHMGEN_STEP_CLOSED;
}

/* Without O_CREAT first: `fs.protected_regular` refuses that for another user's file, even to root. */
static inline shmgen_status shmgen_open_file(shmgen_link *link)
{
    shmgen_status status;
    for (int attempt = 0; attempt < SHMGEN_ATTEMPTS; attempt++) {
        link->file = shm_open(link->name, O_RDWR | O_NOFOLLOW | O_NONBLOCK, 0);
        if (link->file >= 0)
            return !shmgen_is_regular(link->file) ? SHMGEN_REGION_OPEN_FAILED
                   : shmgen_mend(link, link->file) ? shmgen_go(link, SHMGEN_STEP_ADMIT)
                                                   : SHMGEN_REGION_NO_ACCESS;
        if (errno != ENOENT)
            return errno == EACCES || errno == EPERM ? SHMGEN_REGION_NO_ACCESS : SHMGEN_REGION_OPEN_FAILED;
        link->file = shm_open(link->name, O_RDWR | O_CREAT | O_EXCL, shmgen_made_mode(link));
        if (link->file >= 0) {
            status = shmgen_give(link, link->file, shmgen_made_mode(link)) ? shmgen_allocate(link->file, link->size)
                                                                           : SHMGEN_REGION_NO_ACCESS;
            if (status == SHMGEN_OK)
                return shmgen_go(link, SHMGEN_STEP_ADMIT);
            /* Whoever has opened it meanwhile sees at the end that the name leads elsewhere. */
            if (shmgen_leads_to(link->name, link->file))
                shm_unlink(link->name);
            return status;
        }
        if (errno != EEXIST)
            return errno == EACCES || errno == EPERM ? SHMGEN_REGION_NO_ACCESS
                   : errno == ENOSPC                 ? SHMGEN_REGION_NO_MEMORY
                                                     : SHMGEN_REGION_OPEN_FAILED;
    }
    return SHMGEN_RESTLESS;
}

/* What lies in the file: one of ours, or nothing yet. */
static inline shmgen_status shmgen_check_header(const shmgen_link *link, uint32_t *magic)
{
    shmgen_region found;
    struct stat status;
    memset(&found, 0, sizeof found);
    if (fstat(link->file, &status) != 0 || pread(link->file, &found, sizeof found, 0) < 0)
        return SHMGEN_REGION_OPEN_FAILED;
    *magic = found.magic;
    if (found.magic != 0 && found.magic != SHMGEN_MAGIC)
        return SHMGEN_NOT_A_REGION;
    if (found.magic != 0) {
        if (found.abi != SHMGEN_ABI || found.header_size != SHMGEN_HEADER_SIZE)
            return SHMGEN_ABI_MISMATCH;
        if (found.digest != link->type.digest || strncmp(found.type_name, link->type.name, sizeof found.type_name) != 0)
            return SHMGEN_DIGEST_MISMATCH;
        if (found.payload_size != link->type.size || found.slot_size != link->slot_size)
            return SHMGEN_PAYLOAD_MISMATCH;
        if (found.slots != link->slots)
            return SHMGEN_DEPTH_MISMATCH;
    }
    return (uint64_t)status.st_size == link->size ? SHMGEN_OK : SHMGEN_REGION_SIZE_MISMATCH;
}

/* Magic last. */
static inline void shmgen_write_header(shmgen_link *link)
{
    shmgen_region made;
    memset(&made, 0, sizeof made);
    made.abi = SHMGEN_ABI;
    made.header_size = SHMGEN_HEADER_SIZE;
    made.digest = link->type.digest;
    made.payload_size = link->type.size;
    made.slot_size = link->slot_size;
    made.slots = link->slots;
    strncpy(made.type_name, link->type.name, SHMGEN_MAX_TYPE_NAME);
    memcpy(link->base + SHMGEN_AT(abi), &made.abi, SHMGEN_AT(writer) - SHMGEN_AT(abi));
    memcpy(link->base + SHMGEN_AT(slots), &made.slots, SHMGEN_AT(begun) - SHMGEN_AT(slots));
    shmgen_store(link, SHMGEN_AT(magic), SHMGEN_MAGIC);
}

/* Makes the page that a forked child finds empty, where Linux has that (4.14) and the C library shows it. */
static inline void shmgen_mark(shmgen_link *link)
{
#ifdef MAP_ANONYMOUS
    void *page = mmap(NULL, SHMGEN_PAGE, PROT_READ | PROT_WRITE, MAP_PRIVATE | MAP_ANONYMOUS, -1, 0);
    if (page == MAP_FAILED)
        return;
    link->mine = (unsigned char *)page;
    link->mine[0] = 1;
    (void)madvise(page, SHMGEN_PAGE, 18); /* MADV_WIPEONFORK, which older headers do not name */
#else
    (void)link;
#endif
}

/* The file is known and of a size: its header, checked before anything of it is mapped. */
static inline shmgen_status shmgen_map(shmgen_link *link)
{
    struct stat status;
    uint32_t magic;
    shmgen_status checked;
    void *base;
    if (!shmgen_is_safe(link, link->file)) /* its maker may be about to give it its group */
        return shmgen_elapsed(link) > SHMGEN_PEER_MS * SHMGEN_MS ? SHMGEN_STRANGER : SHMGEN_OPENING;
    if (fstat(link->file, &status) != 0)
        return SHMGEN_REGION_OPEN_FAILED;
    if (status.st_size == 0) { /* who died between making it and giving it its size is stood in for */
        if (shmgen_elapsed(link) <= SHMGEN_PEER_MS * SHMGEN_MS)
            return SHMGEN_OPENING;
        checked = shmgen_allocate(link->file, link->size);
        if (checked != SHMGEN_OK)
            return checked;
    }
    checked = shmgen_check_header(link, &magic);
    if (checked != SHMGEN_OK)
        return checked;
    base = mmap(NULL, (size_t)link->size, PROT_READ | PROT_WRITE, MAP_SHARED, link->file, 0);
    if (base == MAP_FAILED)
        return SHMGEN_REGION_NO_MEMORY;
    link->base = (unsigned char *)base;
    shmgen_mark(link);
    return shmgen_go(link, SHMGEN_STEP_HEADER);
}

/* Whoever finds no magic writes the header; the record lock lets one process do it at a time. A PLC may do it at the
 * same time, of another layout: whoever has written looks again before anything is used. */
static inline shmgen_status shmgen_complete_header(shmgen_link *link)
{
    bool alone = shmgen_byte(link, SHMGEN_REPAIR_LOCK, F_WRLCK);
    uint32_t magic;
    shmgen_status checked;
    if (!alone && shmgen_elapsed(link) < SHMGEN_PEER_MS * SHMGEN_MS)
        return SHMGEN_OPENING;
    checked = shmgen_check_header(link, &magic);
    if (checked != SHMGEN_OK)
        return checked;
    if (magic == 0) {
        shmgen_write_header(link);
        return shmgen_go(link, SHMGEN_STEP_SETTLE);
    }
    shmgen_byte(link, SHMGEN_REPAIR_LOCK, F_UNLCK);
    return shmgen_go(link, SHMGEN_STEP_LOCK);
}

static inline shmgen_status shmgen_settle(shmgen_link *link)
{
    uint32_t magic;
    shmgen_status checked;
    if (shmgen_elapsed(link) < SHMGEN_OTHER_MAKER)
        return SHMGEN_OPENING;
    shmgen_byte(link, SHMGEN_REPAIR_LOCK, F_UNLCK);
    checked = shmgen_check_header(link, &magic);
    return checked == SHMGEN_OK ? shmgen_go(link, SHMGEN_STEP_LOCK) : checked;
}

/* Whether a file is a semaphore of this machine's C library, which believes what lies there: it maps as many bytes as
 * its sem_t has, and aborts at a post where the word that says private or shared is neither (FUTEX_SHARED is 128). */
static inline bool shmgen_is_semaphore(int file)
{
    unsigned char data[33];
    uint32_t sharing;
    ssize_t length = pread(file, data, sizeof data, 0);
    if (length != 16 && length != 32)
        return false;
    memcpy(&sharing, data + (sizeof(void *) == 8 ? 8 : 4), sizeof sharing);
    return (size_t)length != sizeof(sem_t) || sharing == 0 || sharing == 128;
}

/* The semaphore of the region with that ending to its name, opened or made with that value. */
static inline shmgen_status shmgen_open_semaphore(shmgen_link *link, const char *ending, unsigned value, sem_t **found)
{
    char name[280] = "/sem."; /* as shared memory is called, in which the C library keeps it */
    strcpy(name + 5, link->name + 1);
    strcat(name, ending);
    char own[280] = "/";
    strcat(own, name + 5);
    for (int attempt = 0; attempt < SHMGEN_ATTEMPTS; attempt++) {
        int file = shm_open(name, O_RDWR | O_NOFOLLOW | O_NONBLOCK, 0);
        shmgen_status status = SHMGEN_OK;
        if (file >= 0) {
            if (!shmgen_is_regular(file) || !shmgen_mend(link, file))
                status = SHMGEN_SEMAPHORE_NO_ACCESS;
            else if (!shmgen_is_safe(link, file)) /* see shmgen_map() */
                status = shmgen_elapsed(link) > SHMGEN_PEER_MS * SHMGEN_MS ? SHMGEN_STRANGER : SHMGEN_OPENING;
            else if (!shmgen_is_semaphore(file))
                status = SHMGEN_SEMAPHORE_FAILED;
            else {
                sem_t *opened = sem_open(own, 0);
                if (opened != SEM_FAILED && shmgen_leads_to(name, file)) /* its name may have gone to another */
                    *found = opened;
                else if (opened != SEM_FAILED)
                    sem_close(opened);
            }
            close(file);
            if (status != SHMGEN_OK || *found != NULL)
                return status;
        } else if (errno == EACCES || errno == EPERM) {
            return SHMGEN_SEMAPHORE_NO_ACCESS;
        } else if (errno != ENOENT) {
            return SHMGEN_SEMAPHORE_FAILED;
        } else {
            sem_t *made = sem_open(own, O_CREAT | O_EXCL, shmgen_made_mode(link), value);
            if (made != SEM_FAILED) {
                sem_close(made);
                file = shm_open(name, O_RDWR | O_NOFOLLOW | O_NONBLOCK, 0);
                if (file >= 0 && !shmgen_give(link, file, shmgen_made_mode(link)))
                    status = SHMGEN_SEMAPHORE_NO_ACCESS;
                if (file >= 0)
                    close(file);
                if (status != SHMGEN_OK)
                    return status;
            } else if (errno != EEXIST && errno != ENOENT) {
                return errno == EACCES || errno == EPERM ? SHMGEN_SEMAPHORE_NO_ACCESS : SHMGEN_SEMAPHORE_FAILED;
            }
        }
    }
    return SHMGEN_RESTLESS;
}

/* The event that wakes a reader. */
static inline shmgen_status shmgen_open_event(shmgen_link *link)
{
    return link->type.sequence != 0 || link->event != NULL ? SHMGEN_OK
                                                           : shmgen_open_semaphore(link, "-event", 0, &link->event);
}

static inline shmgen_status shmgen_open_lock(shmgen_link *link)
{
    shmgen_status status = SHMGEN_OK;
    int value = 1;
    if (link->type.sequence == 0 && link->lock == NULL)
        status = shmgen_open_semaphore(link, "", 1, &link->lock);
    if (status != SHMGEN_OK)
        return status;
    if (!shmgen_leads_to(link->name, link->file)) { /* removed meanwhile */
        uint32_t attempts = link->attempts + 1;
        shmgen_link_close(link);
        link->attempts = attempts;
        return attempts < SHMGEN_ATTEMPTS ? shmgen_go(link, SHMGEN_STEP_FILE) : SHMGEN_RESTLESS;
    }
    /* Who is inside may be stuck: its time runs beside that in which a writer makes sure of its claim. */
    if (link->lock != NULL && sem_getvalue(link->lock, &value) == 0 && value < 1)
        shmgen_note_stay(link);
    link->step = SHMGEN_STEP_CLAIM;
    return SHMGEN_OK;
}

/* One step, which does not wait: SHMGEN_OPENING until the region is open (SHMGEN_OK, at SHMGEN_STEP_CLAIM), or an error
 * after which all is closed. Readers are ready there; a writer has to claim the topic. */
static inline shmgen_status shmgen_link_step(shmgen_link *link)
{
    shmgen_status status = SHMGEN_CLOSED;
    switch ((shmgen_step)link->step) {
    case SHMGEN_STEP_FILE: status = shmgen_open_file(link); break;
    case SHMGEN_STEP_ADMIT: status = shmgen_map(link); break;
    case SHMGEN_STEP_HEADER: status = shmgen_complete_header(link); break;
    case SHMGEN_STEP_SETTLE: status = shmgen_settle(link); break;
    case SHMGEN_STEP_LOCK: status = shmgen_open_lock(link); break;
    case SHMGEN_STEP_CLOSED: break;
    case SHMGEN_STEP_CLAIM:
    case SHMGEN_STEP_WATCH:
    case SHMGEN_STEP_CONFIRM:
    case SHMGEN_STEP_READY: status = SHMGEN_OK; break;
    }
    if (status != SHMGEN_OK && status != SHMGEN_OPENING)
        shmgen_link_close(link);
    return status;
}

#ifdef __cplusplus
}
#endif

#endif
