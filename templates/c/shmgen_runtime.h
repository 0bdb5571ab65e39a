/* All that a program needs to take part in the protocol of docs/protocol.md; each message's own calls are in the header
 * beside its structure, pose_shm.h beside pose.h.
 *
 * Made by shmgen; changes made here are lost.
 */
#ifndef SHMGEN_RUNTIME_H
#define SHMGEN_RUNTIME_H

#include "shmgen_publisher.h"
#include "shmgen_subscriber.h"

#endif
