/* Calls the C code from iec2c every millisecond, like the runtime of OpenPLC v3 or Beremiz. */
#include "iec_std_lib.h"

#include <stdio.h>
#include <time.h>
#include <unistd.h>

TIME __CURRENT_TIME;
BOOL __DEBUG;
void config_init__(void);
void config_run__(unsigned long tick);

int main(void)
{
    config_init__();
    printf("running\n");
    fflush(stdout);
    for (unsigned long tick = 0;; tick++) {
        struct timespec now;
        clock_gettime(CLOCK_MONOTONIC, &now);
        __CURRENT_TIME.tv_sec = now.tv_sec;
        __CURRENT_TIME.tv_nsec = now.tv_nsec;
        config_run__(tick);
        usleep(1000);
    }
}
