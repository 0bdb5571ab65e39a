#include "ends.h"

#include <stdio.h>

shmgen_status c_open(c_end *end, const char *topic, int is_writer, const shmgen_options *options, int is_blocking)
{
    end->is_writer = is_writer;
    if (is_writer)
        return is_blocking ? shm_demo_msgs_Demo_publisher_open(&end->publisher, topic, options)
                           : shm_demo_msgs_Demo_publisher_start(&end->publisher, topic, options);
    return is_blocking ? shm_demo_msgs_Demo_subscriber_open(&end->subscriber, topic, options)
                       : shm_demo_msgs_Demo_subscriber_start(&end->subscriber, topic, options);
}

shmgen_status c_step(c_end *end)
{
    return end->is_writer ? shmgen_publisher_step(&end->publisher.end) : shmgen_subscriber_step(&end->subscriber.end);
}

static shm_demo_msgs_Demo make_message(uint32_t a)
{
    shm_demo_msgs_Demo message = {0};
    message.a = a;
    message.b = 2 * a;
    snprintf(message.label, sizeof message.label, "x%u", (unsigned)(a % 1000));
    message.inner.k = 7;
    message.inner.v = 1.25;
    message.tail_count = 2;
    message.tail[0] = (int32_t)a;
    message.tail[1] = -(int32_t)a;
    return message;
}

shmgen_status c_publish(c_end *end, uint32_t a, int is_blocking)
{
    const shm_demo_msgs_Demo message = make_message(a);
    return is_blocking ? shm_demo_msgs_Demo_publisher_publish(&end->publisher, &message)
                       : shm_demo_msgs_Demo_publisher_try_publish(&end->publisher, &message);
}

shmgen_status c_publish_misfit(c_end *end, const char *fault)
{
    shm_demo_msgs_Demo message = make_message(999);
    if (strcmp(fault, "count") == 0)
        message.tail_count = 4;
    else
        memset(message.label, 'y', sizeof message.label);
    return shm_demo_msgs_Demo_publisher_publish(&end->publisher, &message);
}

shmgen_status c_read(c_end *end, const char *command, int64_t ns, shm_demo_msgs_Demo *message)
{
    if (strcmp(command, "next") == 0)
        return shm_demo_msgs_Demo_subscriber_read_next(&end->subscriber, message);
    if (strcmp(command, "wait") == 0)
        return shm_demo_msgs_Demo_subscriber_wait(&end->subscriber, message, ns);
    if (strcmp(command, "try") == 0)
        return shm_demo_msgs_Demo_subscriber_try_read(&end->subscriber, message);
    return shm_demo_msgs_Demo_subscriber_read(&end->subscriber, message);
}

void c_close(c_end *end)
{
    if (end->is_writer)
        shm_demo_msgs_Demo_publisher_close(&end->publisher);
    else
        shm_demo_msgs_Demo_subscriber_close(&end->subscriber);
}
