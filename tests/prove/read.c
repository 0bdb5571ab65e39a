/* A reader, by whatever calls in whatever order. */
#include "anything.h"

static shmgen_subscriber self;
static shm_diagnostic_msgs_DiagnosticArray into;

static void with(sem_t *lock)
{
    const shmgen_receive receive = shmgen_receive_shm_diagnostic_msgs_DiagnosticArray;
    opened(&self.end, shmgen_type_of_shm_diagnostic_msgs_DiagnosticArray(), lock);
    self.last = any;
    while (some()) {
        if (some())
            shmgen_subscriber_read(&self, &into, sizeof into, limit(), receive);
        if (some())
            shmgen_subscriber_read_next(&self, &into, sizeof into, limit(), receive);
        if (some())
            shmgen_subscriber_is_stale(&self, limit());
        if (some())
            shmgen_subscriber_age(&self);
    }
    shmgen_subscriber_close(&self);
}

int main(void)
{
    with(NULL);
    with(&semaphores[0]);
}
