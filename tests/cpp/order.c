/* In which order the shipped ends load and store the words that others look at, where they copy, and where nothing may pass.
 *
 *   order TOPIC      prints a line for each call: `turn` is a load, `turn=` a store, `|acquire` a fence, `copy` a payload
 */
#include "shm_plc_demo/shmgen.h"

#include <stdio.h>
#include <string.h>

static const unsigned char *region;
static size_t slot_seen;
static int quiet = 1;

static void note(const void *at, const char *how)
{
    static const struct {
        size_t offset;
        const char *name;
    } words[] = {
#define WORD(name) {offsetof(shmgen_region, name), #name}
        WORD(magic),       WORD(writer),     WORD(completed0), WORD(completed1), WORD(turn),   WORD(left), WORD(heartbeat),
        WORD(lock_holder), WORD(recoveries), WORD(armed),      WORD(lock_count), WORD(missed), WORD(bell),
    };
    const size_t offset = (size_t)((const unsigned char *)at - region);
    if (quiet)
        return;
    for (size_t index = 0; index < sizeof words / sizeof *words; index++)
        if (offset == words[index].offset)
            printf(" %s%s", words[index].name, how);
    if (offset == slot_seen + offsetof(shmgen_slot, number))
        printf(" number%s", how);
}

static void fenced(const char *order)
{
    if (!quiet)
        printf(" |%s", order + sizeof "__ATOMIC_" - 1);
}

static void *copied(void *into, const void *from, size_t size)
{
    if (!quiet)
        printf(" copy");
    return memcpy(into, from, size);
}

#define SHMGEN_COPY copied
#define __atomic_load_n(at, order) (note(at, ""), *(const volatile __typeof__(*(at)) *)(at))
#define __atomic_store_n(at, value, order) (note(at, "="), (void)(*(volatile __typeof__(*(at)) *)(at) = (value)))
#define __atomic_thread_fence(order) fenced(#order)
#include "shm_plc_demo/demo_msgs/msg/demo_shm.h"

static shm_demo_msgs_Demo_publisher publisher;
static shm_demo_msgs_Demo_subscriber subscriber;
static shm_demo_msgs_Demo message;

static void look(const char *name, shmgen_status (*call)(void))
{
    printf("%s:", name);
    slot_seen = shmgen_slot_of(&publisher.end.end, 1, 0);
    quiet = 0;
    shmgen_status status = call();
    quiet = 1;
    printf("%s%s\n", status != SHMGEN_OK ? " -> " : "", status != SHMGEN_OK ? shmgen_status_text(status) : "");
}

static shmgen_status publish(void) { return shm_demo_msgs_Demo_publisher_try_publish(&publisher, &message); }

static shmgen_status read_newest(void) { return shm_demo_msgs_Demo_subscriber_try_read(&subscriber, &message); }

static shmgen_status borrow(void)
{
    const void *payload = NULL;
    shmgen_status status = shmgen_subscriber_borrow(&subscriber.end, &payload);
    if (status == SHMGEN_OK)
        copied(&message, payload, sizeof message);
    return status == SHMGEN_OK ? shmgen_subscriber_return(&subscriber.end) : status;
}

static shmgen_status sleep_until_posted(void)
{
    shmgen_subscriber *waits = &subscriber.end;
    subscriber.end.last = 0;
    shmgen_sleep(&waits, 1, 0);
    return SHMGEN_OK;
}

static shmgen_status take_over(void) { return shmgen_take_over(&subscriber.end.end, 0) ? SHMGEN_OK : SHMGEN_LOCK_TIMEOUT; }

int main(int count, char **words)
{
    if (count != 2 || shm_demo_msgs_Demo_publisher_open(&publisher, words[1], NULL) != SHMGEN_OK ||
        shm_demo_msgs_Demo_subscriber_open(&subscriber, words[1], NULL) != SHMGEN_OK)
        return 1;
    region = publisher.end.end.base;
    look("publish", publish);
    region = subscriber.end.end.base;
    look("read", read_newest);
    subscriber.end.last = 0;
    look("borrow", borrow);
    shmgen_open_event(&subscriber.end.end);
    look("sleep", sleep_until_posted);
    sem_trywait(subscriber.end.end.lock); /* its holder is dead */
    shmgen_note_holder(&subscriber.end.end);
    look("take over", take_over);
    shmgen_store(&subscriber.end.end, SHMGEN_AT(lock_holder), 77); /* somebody is in meanwhile */
    look("take over what has changed", take_over);
    return 0;
}
