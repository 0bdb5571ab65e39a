/* What the peer does in C: compiled as C11, called from C++. */
#ifndef ENDS_H
#define ENDS_H

#include "shm_plc_demo/demo_msgs/msg/demo_shm.h"

#ifdef __cplusplus
extern "C" {
#endif

typedef struct c_end {
    shm_demo_msgs_Demo_publisher publisher;
    shm_demo_msgs_Demo_subscriber subscriber;
    int writes;
} c_end;

shmgen_status c_open(c_end *end, const char *topic, int writes, const shmgen_options *options, int waits);
shmgen_status c_step(c_end *end);
shmgen_status c_publish(c_end *end, uint32_t a, int waits);
shmgen_status c_publish_misfit(c_end *end, const char *what);
shmgen_status c_read(c_end *end, const char *how, int64_t ns, shm_demo_msgs_Demo *into);
void c_close(c_end *end);

#ifdef __cplusplus
}
#endif

#endif
