/* Print in which order the C endpoints load and store the shared header fields, copy payloads, and set fences.
 * `order TOPIC` prints one line per call: `turn` is a load, `turn=` a store, `|ACQUIRE` a fence, `copy` a copied payload. */
#include "shm_plc_demo/shmgen.h"

#include <stdio.h>
#include <string.h>

static const unsigned char *region;
static size_t published_slot;
static int is_quiet = 1;

static void print_access(const void *address, const char *suffix)
{
    static const struct {
        size_t offset;
        const char *name;
    } fields[] = {
#define FIELD(name) {offsetof(shmgen_region, name), #name}
        FIELD(magic),       FIELD(writer),     FIELD(completed0), FIELD(completed1), FIELD(turn),   FIELD(left), FIELD(heartbeat),
        FIELD(lock_holder), FIELD(recoveries), FIELD(armed),      FIELD(lock_count), FIELD(missed), FIELD(bell),
    };
    const size_t offset = (size_t)((const unsigned char *)address - region);
    if (is_quiet)
        return;
    for (size_t index = 0; index < sizeof fields / sizeof *fields; index++)
        if (offset == fields[index].offset)
            printf(" %s%s", fields[index].name, suffix);
    if (offset == published_slot + offsetof(shmgen_slot, number))
        printf(" number%s", suffix);
}

static void print_fence(const char *order)
{
    if (!is_quiet)
        printf(" |%s", order + sizeof "__ATOMIC_" - 1);
}

static void *copy_and_print(void *target, const void *source, size_t size)
{
    if (!is_quiet)
        printf(" copy");
    return memcpy(target, source, size);
}

#define SHMGEN_COPY copy_and_print
#define __atomic_load_n(field, order) (print_access(field, ""), *(const volatile __typeof__(*(field)) *)(field))
#define __atomic_store_n(field, value, order) (print_access(field, "="), (void)(*(volatile __typeof__(*(field)) *)(field) = (value)))
#define __atomic_thread_fence(order) print_fence(#order)
#include "shm_plc_demo/demo_msgs/msg/demo_shm.h"

static shm_demo_msgs_Demo_publisher publisher;
static shm_demo_msgs_Demo_subscriber subscriber;
static shm_demo_msgs_Demo message;

static void print_accesses(const char *name, shmgen_status (*call)(void))
{
    printf("%s:", name);
    published_slot = shmgen_slot_of(&publisher.end.end, 1, 0);
    is_quiet = 0;
    shmgen_status status = call();
    is_quiet = 1;
    printf("%s%s\n", status != SHMGEN_OK ? " -> " : "", status != SHMGEN_OK ? shmgen_status_text(status) : "");
}

static shmgen_status publish(void) { return shm_demo_msgs_Demo_publisher_try_publish(&publisher, &message); }

static shmgen_status read_newest(void) { return shm_demo_msgs_Demo_subscriber_try_read(&subscriber, &message); }

static shmgen_status borrow_and_return(void)
{
    const void *payload = NULL;
    shmgen_status status = shmgen_subscriber_borrow(&subscriber.end, &payload);
    if (status == SHMGEN_OK)
        copy_and_print(&message, payload, sizeof message);
    return status == SHMGEN_OK ? shmgen_subscriber_return(&subscriber.end) : status;
}

static shmgen_status sleep_until_posted(void)
{
    shmgen_subscriber *waiting = &subscriber.end;
    subscriber.end.last = 0;
    shmgen_sleep(&waiting, 1, 0);
    return SHMGEN_OK;
}

static shmgen_status take_over(void) { return shmgen_take_over(&subscriber.end.end, 0) ? SHMGEN_OK : SHMGEN_LOCK_TIMEOUT; }

int main(int argc, char **argv)
{
    if (argc != 2 || shm_demo_msgs_Demo_publisher_open(&publisher, argv[1], NULL) != SHMGEN_OK ||
        shm_demo_msgs_Demo_subscriber_open(&subscriber, argv[1], NULL) != SHMGEN_OK)
        return 1;
    region = publisher.end.end.base;
    print_accesses("publish", publish);
    region = subscriber.end.end.base;
    print_accesses("read", read_newest);
    subscriber.end.last = 0;
    print_accesses("borrow", borrow_and_return);
    shmgen_open_event(&subscriber.end.end);
    print_accesses("sleep", sleep_until_posted);
    sem_trywait(subscriber.end.end.lock); /* simulate a dead lock holder */
    shmgen_note_holder(&subscriber.end.end);
    print_accesses("take over", take_over);
    shmgen_store(&subscriber.end.end, SHMGEN_AT(lock_holder), 77); /* simulate another process that took the lock meanwhile */
    print_accesses("take over after the holder changed", take_over);
    return 0;
}
