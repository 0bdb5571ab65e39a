/* C on another machine: `self TOPIC` writes and reads by itself, `echo TOPIC COUNT` sends back what it hears on TOPIC/in,
 * `sequence TOPIC COUNT` the same without a lock. Says how it ended.
 */
#include "ends.h"

#include <stdio.h>
#include <stdlib.h>

static int said(const char *what, shmgen_status status)
{
    printf("%s: %d %s\n", what, (int)status, shmgen_status_text(status));
    return 1;
}

/* Whether our look at a semaphore sees what the C library's does, also while others wait (the second word, on 64 bits). */
static int counts_tokens(void)
{
    for (unsigned value = 0; value < 4; value++)
        for (uint32_t waiting = 0; waiting < 3; waiting++) {
            sem_t semaphore;
            int there = -1;
            sem_init(&semaphore, 1, value);
            memcpy((unsigned char *)&semaphore + sizeof waiting, &waiting, sizeof waiting);
            sem_getvalue(&semaphore, &there);
            if (there != (int)value || shmgen_tokens(&semaphore) != there)
                return 0;
        }
    return 1;
}

static int self(const char *topic)
{
    c_end writer, reader;
    shm_demo_msgs_Demo found;
    shmgen_options options = {0};
    shmgen_status status;
    options.depth = 4;
    if (!counts_tokens())
        return said("tokens", SHMGEN_OK);
    if ((status = c_open(&writer, topic, 1, &options, 1)) != SHMGEN_OK)
        return said("publisher", status);
    if ((status = c_open(&reader, topic, 0, &options, 1)) != SHMGEN_OK)
        return said("subscriber", status);
    for (uint32_t a = 1; a <= 100; a++) {
        if ((status = c_publish(&writer, a, 1)) != SHMGEN_OK)
            return said("publish", status);
        if ((status = c_read(&reader, a % 2 ? "read" : "next", 0, &found)) != SHMGEN_OK)
            return said("read", status);
        if (found.a != a || found.b != 2 * a || found.inner.v < 1.25 || found.tail[1] != -(int32_t)a)
            return said("values", SHMGEN_OK);
    }
    if (!shmgen_enter(&reader.subscriber.end.end, 0))
        return said("enter", SHMGEN_LOCK_TIMEOUT);
    status = c_publish(&writer, 101, 0); /* while somebody is inside */
    printf("100 samples; with the lock held: %d", (int)status);
    shmgen_store(&reader.subscriber.end.end, SHMGEN_AT(lock_holder), 0x7FFFFFFE); /* a pid that Linux gives nobody */
    status = c_publish(&writer, 102, 1);
    if (status == SHMGEN_OK)
        status = c_read(&reader, "read", 0, &found);
    printf(", by a dead process: %d %u\n", (int)status, (unsigned)found.a);
    c_close(&writer);
    c_close(&reader);
    return 0;
}

static int echo(const char *topic, int count, uint32_t sequence)
{
    shmgen_type type = shmgen_type_of_shm_demo_msgs_Demo();
    shmgen_publisher out;
    shmgen_subscriber in;
    shm_demo_msgs_Demo found;
    shmgen_status status;
    char name[100];
    type.sequence = sequence;
    snprintf(name, sizeof name, "%s/in", topic);
    if ((status = shmgen_subscriber_open(&in, name, &type, NULL)) != SHMGEN_OK)
        return said("subscriber", status);
    if ((status = shmgen_publisher_open(&out, topic, &type, NULL)) != SHMGEN_OK)
        return said("publisher", status);
    printf("ready\n");
    fflush(stdout);
    while (count-- > 0) {
        status = shmgen_subscriber_wait(
            &in, &found, sizeof found, INT64_C(20000000000), shmgen_receive_shm_demo_msgs_Demo);
        if (status != SHMGEN_OK)
            return said("wait", status);
        found.a++;
        if ((status = shmgen_publisher_write(&out, &found, sizeof found, out.end.limit)) != SHMGEN_OK)
            return said("publish", status);
    }
    printf("%u missed\n", (unsigned)in.missed);
    shmgen_publisher_close(&out);
    shmgen_subscriber_close(&in);
    return 0;
}

int main(int count, char **words)
{
    if (count == 3)
        return self(words[2]);
    return count == 4 ? echo(words[2], atoi(words[3]), words[1][0] == 's') : 1;
}
