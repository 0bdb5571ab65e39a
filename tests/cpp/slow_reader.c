/* A reader in C that is slower than its writer. The writer publishes two samples while the reader copies one sample.
 * `slow_reader TOPIC` exits with 0 if the reader gets a sample. */
#include "shm_plc_demo/shmgen.h"

#include <stdio.h>
#include <string.h>

static void *copy_slowly(void *target, const void *source, size_t size);

#define SHMGEN_COPY copy_slowly
#include "shm_plc_demo/demo_msgs/msg/demo_shm.h"

static shm_demo_msgs_Demo_publisher publisher;
static shm_demo_msgs_Demo_subscriber subscriber;
static shm_demo_msgs_Demo message;
static int samples_per_copy;

static void publish(int samples)
{
    const int previous = samples_per_copy;
    samples_per_copy = 0; /* the publisher copies as well */
    for (; samples > 0; samples--)
        shm_demo_msgs_Demo_publisher_try_publish(&publisher, &message);
    samples_per_copy = previous;
}

static void *copy_slowly(void *target, const void *source, size_t size)
{
    publish(samples_per_copy);
    return memcpy(target, source, size);
}

int main(int argc, char **argv)
{
    const shmgen_options options = {.depth = 8};
    shmgen_status status;
    if (argc != 2 || shm_demo_msgs_Demo_publisher_open(&publisher, argv[1], &options) != SHMGEN_OK ||
        shm_demo_msgs_Demo_subscriber_open(&subscriber, argv[1], &options) != SHMGEN_OK)
        return 1;
    publish(40);
    subscriber.end.last = 1;
    samples_per_copy = 2;
    status = shm_demo_msgs_Demo_subscriber_read_next(&subscriber, &message);
    printf("%s\n", shmgen_status_text(status));
    return status != SHMGEN_OK;
}
