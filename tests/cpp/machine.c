/* Endpoints in C for other CPUs. `self TOPIC` writes samples and reads them back. `echo TOPIC COUNT` publishes on TOPIC each
 * sample that it reads from TOPIC/in, and `sequence TOPIC COUNT` does so without a lock. Prints the result. */
#include "ends.h"

#include <stdio.h>
#include <stdlib.h>

static int report_failure(const char *call, shmgen_status status)
{
    printf("%s: %d %s\n", call, (int)status, shmgen_status_text(status));
    return 1;
}

/* Return 1 if shmgen_tokens() agrees with sem_getvalue(), also if threads wait (counted in bytes 4 to 7 on 64-bit machines). */
static int is_semaphore_value_right(void)
{
    for (unsigned value = 0; value < 4; value++)
        for (uint32_t waiters = 0; waiters < 3; waiters++) {
            sem_t semaphore;
            int expected = -1;
            sem_init(&semaphore, 1, value);
            memcpy((unsigned char *)&semaphore + sizeof waiters, &waiters, sizeof waiters);
            sem_getvalue(&semaphore, &expected);
            if (expected != (int)value || shmgen_tokens(&semaphore) != expected)
                return 0;
        }
    return 1;
}

static int exchange_with_itself(const char *topic)
{
    c_end writer, reader;
    shm_demo_msgs_Demo message;
    shmgen_options options = {0};
    shmgen_status status;
    options.depth = 4;
    if (!is_semaphore_value_right())
        return report_failure("shmgen_tokens", SHMGEN_OK);
    if ((status = c_open(&writer, topic, 1, &options, 1)) != SHMGEN_OK)
        return report_failure("publisher", status);
    if ((status = c_open(&reader, topic, 0, &options, 1)) != SHMGEN_OK)
        return report_failure("subscriber", status);
    for (uint32_t a = 1; a <= 100; a++) {
        if ((status = c_publish(&writer, a, 1)) != SHMGEN_OK)
            return report_failure("publish", status);
        if ((status = c_read(&reader, a % 2 ? "read" : "next", 0, &message)) != SHMGEN_OK)
            return report_failure("read", status);
        if (message.a != a || message.b != 2 * a || message.inner.v < 1.25 || message.tail[1] != -(int32_t)a)
            return report_failure("values", SHMGEN_OK);
    }
    if (!shmgen_enter(&reader.subscriber.end.end, 0))
        return report_failure("enter", SHMGEN_LOCK_TIMEOUT);
    status = c_publish(&writer, 101, 0); /* while the reader holds the lock */
    printf("100 samples; with the lock held: %d", (int)status);
    shmgen_store(&reader.subscriber.end.end, SHMGEN_AT(lock_holder), 0x7FFFFFFE); /* no process has this id */
    status = c_publish(&writer, 102, 1);
    if (status == SHMGEN_OK)
        status = c_read(&reader, "read", 0, &message);
    printf(", by a dead process: %d %u\n", (int)status, (unsigned)message.a);
    c_close(&writer);
    c_close(&reader);
    return 0;
}

static int echo_samples(const char *topic, int samples, uint32_t sequence)
{
    shmgen_type type = shmgen_type_of_shm_demo_msgs_Demo();
    shmgen_publisher publisher;
    shmgen_subscriber subscriber;
    shm_demo_msgs_Demo message;
    shmgen_status status;
    char input_topic[100];
    type.sequence = sequence;
    snprintf(input_topic, sizeof input_topic, "%s/in", topic);
    if ((status = shmgen_subscriber_open(&subscriber, input_topic, &type, NULL)) != SHMGEN_OK)
        return report_failure("subscriber", status);
    if ((status = shmgen_publisher_open(&publisher, topic, &type, NULL)) != SHMGEN_OK)
        return report_failure("publisher", status);
    printf("ready\n");
    fflush(stdout);
    while (samples-- > 0) {
        status = shmgen_subscriber_wait(
            &subscriber, &message, sizeof message, INT64_C(20000000000), shmgen_receive_shm_demo_msgs_Demo);
        if (status != SHMGEN_OK)
            return report_failure("wait", status);
        message.a++;
        if ((status = shmgen_publisher_write(&publisher, &message, sizeof message, publisher.end.limit)) != SHMGEN_OK)
            return report_failure("publish", status);
    }
    printf("%u missed\n", (unsigned)subscriber.missed);
    shmgen_publisher_close(&publisher);
    shmgen_subscriber_close(&subscriber);
    return 0;
}

int main(int argc, char **argv)
{
    if (argc == 3)
        return exchange_with_itself(argv[2]);
    return argc == 4 ? echo_samples(argv[2], atoi(argv[3]), argv[1][0] == 's') : 1;
}
