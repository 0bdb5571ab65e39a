/* A reader, with all calls in any order. */
#include "environment.h"

static shmgen_subscriber subscriber;
static shm_diagnostic_msgs_DiagnosticArray message;

static void read_with_lock(sem_t *lock)
{
    const shmgen_receive receive = shmgen_receive_shm_diagnostic_msgs_DiagnosticArray;
    set_open_state(&subscriber.end, shmgen_type_of_shm_diagnostic_msgs_DiagnosticArray(), lock);
    subscriber.last = any;
    while (any_bool()) {
        if (any_bool())
            shmgen_subscriber_read(&subscriber, &message, sizeof message, any_timeout(), receive);
        if (any_bool())
            shmgen_subscriber_read_next(&subscriber, &message, sizeof message, any_timeout(), receive);
        if (any_bool())
            shmgen_subscriber_is_stale(&subscriber, any_timeout());
        if (any_bool())
            shmgen_subscriber_age(&subscriber);
    }
    shmgen_subscriber_close(&subscriber);
}

int main(void)
{
    read_with_lock(NULL);
    read_with_lock(&semaphores[0]);
}
