/* The endpoints of peer.cpp and machine.c in C, compiled as C11. */
#ifndef ENDS_H
#define ENDS_H

#include "shm_plc_demo/demo_msgs/msg/demo_shm.h"

#ifdef __cplusplus
extern "C" {
#endif

typedef struct c_end {
    shm_demo_msgs_Demo_publisher publisher;
    shm_demo_msgs_Demo_subscriber subscriber;
    int is_writer;
} c_end;

shmgen_status c_open(c_end *end, const char *topic, int is_writer, const shmgen_options *options, int is_blocking);
shmgen_status c_step(c_end *end);
shmgen_status c_publish(c_end *end, uint32_t a, int is_blocking);
shmgen_status c_publish_misfit(c_end *end, const char *fault);
shmgen_status c_read(c_end *end, const char *command, int64_t ns, shm_demo_msgs_Demo *message);
void c_close(c_end *end);

#ifdef __cplusplus
}
#endif

#endif
