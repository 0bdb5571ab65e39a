/* A writer: each call with any message, from each state that earlier calls can leave. */
#include "environment.h"

static shmgen_publisher publisher;
static shm_diagnostic_msgs_DiagnosticArray message;

static void call_any_function(void)
{
    void *payload = NULL;
    make_unknown(&message, sizeof message);
    shmgen_path_clear(&publisher.path);
    publisher.sequence = any;
    publisher.number = any;
    publisher.turn = any;
    publisher.beat = any;
    if (any_bool()) {
        if (shmgen_check_shm_diagnostic_msgs_DiagnosticArray(&message, &publisher.path) == SHMGEN_OK)
            shmgen_publisher_write(&publisher, &message, sizeof message, any_timeout());
    } else if (any_bool()) {
        if (shmgen_publisher_begin(&publisher, any_timeout(), &payload) == SHMGEN_OK)
            memcpy(payload, &message, sizeof message);
    } else if (any_bool()) {
        shmgen_publisher_complete(&publisher);
    } else if (any_bool()) {
        shmgen_publisher_cancel(&publisher);
    } else if (any_bool()) {
        shmgen_publisher_heartbeat(&publisher);
    } else {
        shmgen_publisher_close(&publisher);
    }
}

static void call_with_lock(sem_t *lock, uint32_t has_lock)
{
    set_open_state(&publisher.end, shmgen_type_of_shm_diagnostic_msgs_DiagnosticArray(), lock);
    publisher.inside = has_lock;
    call_any_function();
}

int main(void)
{
    call_with_lock(NULL, 0);
    call_with_lock(&semaphores[0], 0);
    call_with_lock(&semaphores[0], 1);
    memset(&publisher, 0, sizeof publisher);
    call_any_function();
}
