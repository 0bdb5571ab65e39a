/* The lock, and the sleep of who waits for one region or for many, whatever semaphores, clock and kernel say. */
#include "anything.h"

static shmgen_link end;

static void slept(size_t armed)
{
    shmgen_sleeper sleeper;
    memset(&sleeper, 0, sizeof sleeper);
    for (int index = 0; index < SHMGEN_MOST_WAITS; index++)
        sleeper.posted[index] = some() ? &end : NULL;
    shmgen_sleeper_begin(&sleeper, limit());
    sleeper.count = armed;
    shmgen_arm(&sleeper, &end);
    shmgen_arm(&sleeper, &end);
    shmgen_sleep_armed(&sleeper);
}

int main(void)
{
    opened(&end, shmgen_type_of_shm_diagnostic_msgs_DiagnosticArray(), &semaphores[0]);
    while (some()) {
        if (shmgen_enter(&end, limit()))
            shmgen_leave(&end);
        slept(0);
        slept((size_t)between(0, SHMGEN_MOST_WAITS));
    }
}
