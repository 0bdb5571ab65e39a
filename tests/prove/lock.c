/* The lock, and the sleep of a reader that waits for one region or for several. Semaphores, clock and kernel return any result. */
#include "environment.h"

static shmgen_link region_link;

static void sleep_after_arming(size_t count)
{
    shmgen_sleeper sleeper;
    memset(&sleeper, 0, sizeof sleeper);
    for (int index = 0; index < SHMGEN_MOST_WAITS; index++)
        sleeper.posted[index] = any_bool() ? &region_link : NULL;
    shmgen_sleeper_begin(&sleeper, any_timeout());
    sleeper.count = count;
    shmgen_arm(&sleeper, &region_link);
    shmgen_arm(&sleeper, &region_link);
    shmgen_sleep_armed(&sleeper);
}

int main(void)
{
    set_open_state(&region_link, shmgen_type_of_shm_diagnostic_msgs_DiagnosticArray(), &semaphores[0]);
    while (any_bool()) {
        if (shmgen_enter(&region_link, any_timeout()))
            shmgen_leave(&region_link);
        sleep_after_arming(0);
        sleep_after_arming((size_t)any_between(0, SHMGEN_MOST_WAITS));
    }
}
