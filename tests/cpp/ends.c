#include "ends.h"

#include <stdio.h>

shmgen_status c_open(c_end *end, const char *topic, int writes, const shmgen_options *options, int waits)
{
    end->writes = writes;
    if (writes)
        return waits ? shm_demo_msgs_Demo_publisher_open(&end->publisher, topic, options)
                     : shm_demo_msgs_Demo_publisher_start(&end->publisher, topic, options);
    return waits ? shm_demo_msgs_Demo_subscriber_open(&end->subscriber, topic, options)
                 : shm_demo_msgs_Demo_subscriber_start(&end->subscriber, topic, options);
}

shmgen_status c_step(c_end *end)
{
    return end->writes ? shmgen_publisher_step(&end->publisher.end) : shmgen_subscriber_step(&end->subscriber.end);
}

static shm_demo_msgs_Demo message(uint32_t a)
{
    shm_demo_msgs_Demo made = {0};
    made.a = a;
    made.b = 2 * a;
    snprintf(made.label, sizeof made.label, "x%u", (unsigned)(a % 1000));
    made.inner.k = 7;
    made.inner.v = 1.25;
    made.tail_count = 2;
    made.tail[0] = (int32_t)a;
    made.tail[1] = -(int32_t)a;
    return made;
}

shmgen_status c_publish(c_end *end, uint32_t a, int waits)
{
    const shm_demo_msgs_Demo made = message(a);
    return waits ? shm_demo_msgs_Demo_publisher_publish(&end->publisher, &made)
                 : shm_demo_msgs_Demo_publisher_try_publish(&end->publisher, &made);
}

shmgen_status c_publish_misfit(c_end *end, const char *what)
{
    shm_demo_msgs_Demo made = message(999);
    if (strcmp(what, "count") == 0)
        made.tail_count = 4;
    else
        memset(made.label, 'y', sizeof made.label);
    return shm_demo_msgs_Demo_publisher_publish(&end->publisher, &made);
}

shmgen_status c_read(c_end *end, const char *how, int64_t ns, shm_demo_msgs_Demo *into)
{
    if (strcmp(how, "next") == 0)
        return shm_demo_msgs_Demo_subscriber_read_next(&end->subscriber, into);
    if (strcmp(how, "wait") == 0)
        return shm_demo_msgs_Demo_subscriber_wait(&end->subscriber, into, ns);
    if (strcmp(how, "try") == 0)
        return shm_demo_msgs_Demo_subscriber_try_read(&end->subscriber, into);
    return shm_demo_msgs_Demo_subscriber_read(&end->subscriber, into);
}

void c_close(c_end *end)
{
    if (end->writes)
        shm_demo_msgs_Demo_publisher_close(&end->publisher);
    else
        shm_demo_msgs_Demo_subscriber_close(&end->subscriber);
}
