/* A writer: each call, from each state that calls leave, of whatever message. */
#include "anything.h"

static shmgen_publisher self;
static shm_diagnostic_msgs_DiagnosticArray message;

static void one_call(void)
{
    void *payload = NULL;
    given(&message, sizeof message);
    shmgen_path_clear(&self.path);
    self.sequence = any;
    self.number = any;
    self.turn = any;
    self.beat = any;
    if (some()) {
        if (shmgen_check_shm_diagnostic_msgs_DiagnosticArray(&message, &self.path) == SHMGEN_OK)
            shmgen_publisher_write(&self, &message, sizeof message, limit());
    } else if (some()) {
        if (shmgen_publisher_begin(&self, limit(), &payload) == SHMGEN_OK)
            memcpy(payload, &message, sizeof message);
    } else if (some()) {
        shmgen_publisher_complete(&self);
    } else if (some()) {
        shmgen_publisher_cancel(&self);
    } else if (some()) {
        shmgen_publisher_heartbeat(&self);
    } else {
        shmgen_publisher_close(&self);
    }
}

static void from(sem_t *lock, uint32_t inside)
{
    opened(&self.end, shmgen_type_of_shm_diagnostic_msgs_DiagnosticArray(), lock);
    self.inside = inside;
    one_call();
}

int main(void)
{
    from(NULL, 0);
    from(&semaphores[0], 0);
    from(&semaphores[0], 1);
    memset(&self, 0, sizeof self);
    one_call();
}
