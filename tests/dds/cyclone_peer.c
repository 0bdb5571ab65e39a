/* Endpoints of a ROS 2 node without ROS, with Cyclone's C library. Publishes each sample of IN on OUT, and prints joint states.

   cyclone_peer DOMAIN reliable|best_effort volatile|latch [TYPE IN OUT]...
   TYPE is a DDS name such as `sensor_msgs::msg::dds_::JointState_`. If IN is `-`, it publishes a joint state on OUT ten times
   per second. With `latch`, it publishes the joint state once, also for late readers. It exits when its stdin is closed. */
#include <dds/dds.h>
#include <poll.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include "peer.h"

static const dds_topic_descriptor_t *types[] = {PEER_TYPES};
struct echo {
    dds_entity_t writer;
    int joint_states;
};

static void print_joint_state(const sensor_msgs_msg_dds__JointState_ *state) {
    printf("took %d.%09u %s", state->header_.stamp_.sec_, state->header_.stamp_.nanosec_, state->header_.frame_id_);
    for (uint32_t i = 0; i < state->name_._length; i++) printf(" %s", state->name_._buffer[i]);
    for (uint32_t i = 0; i < state->position_._length; i++) printf(" %g", state->position_._buffer[i]);
    printf(" | %u %u\n", state->velocity_._length, state->effort_._length);
    fflush(stdout);
}

static void echo_samples(dds_entity_t reader, void *arg) {
    struct echo *echo = arg;
    void *sample = NULL;
    dds_sample_info_t info;
    while (dds_take(reader, &sample, &info, 1, 1) == 1) {
        if (info.valid_data) {
            if (echo->joint_states) print_joint_state(sample);
            if (dds_write(echo->writer, sample) < 0) puts("could not write");
        }
        dds_return_loan(reader, &sample, 1);
        sample = NULL;
    }
}

static void publish_joint_state(dds_entity_t writer) {
    char *names[] = {"shoulder", "elbow"};
    double positions[] = {0.5, -1.25}, efforts[] = {0.001};
    sensor_msgs_msg_dds__JointState_ state = {0};
    state.header_.stamp_.sec_ = 12;
    state.header_.stamp_.nanosec_ = 345678901;
    state.header_.frame_id_ = "base";
    state.name_._buffer = names;
    state.name_._length = state.name_._maximum = 2;
    state.position_._buffer = positions;
    state.position_._length = state.position_._maximum = 2;
    state.effort_._buffer = efforts;
    state.effort_._length = state.effort_._maximum = 1;
    dds_write(writer, &state);
}

static const dds_topic_descriptor_t *type_of(const char *name) {
    for (size_t i = 0; i < sizeof types / sizeof *types; i++)
        if (!strcmp(types[i]->m_typename, name)) return types[i];
    exit(3);
}

int main(int argc, char **argv) {
    if (argc < 7) return 2;
    int is_reliable = !strcmp(argv[2], "reliable"), is_latched = !strcmp(argv[3], "latch");
    dds_entity_t participant = dds_create_participant((dds_domainid_t)atoi(argv[1]), NULL, NULL);
    dds_qos_t *qos = dds_create_qos();
    if (is_reliable) dds_qset_reliability(qos, DDS_RELIABILITY_RELIABLE, DDS_SECS(1));
    else dds_qset_reliability(qos, DDS_RELIABILITY_BEST_EFFORT, 0);
    dds_qset_history(qos, DDS_HISTORY_KEEP_LAST, 1000);
    if (is_latched) {
        dds_qset_durability(qos, DDS_DURABILITY_TRANSIENT_LOCAL);
        dds_qset_durability_service(qos, 0, DDS_HISTORY_KEEP_LAST, 1, -1, -1, -1);
    }
    dds_entity_t own_writer = 0;
    for (char **triple = argv + 4; triple + 2 < argv + argc; triple += 3) {
        const dds_topic_descriptor_t *type = type_of(triple[0]);
        dds_entity_t output_topic = dds_create_topic(participant, type, triple[2], NULL, NULL);
        struct echo *echo = malloc(sizeof *echo);
        echo->joint_states = strstr(triple[0], "JointState_") != NULL;
        echo->writer = dds_create_writer(participant, output_topic, qos, NULL);
        if (echo->writer < 0) return 4;
        if (!strcmp(triple[1], "-")) {
            own_writer = echo->writer;
            continue;
        }
        dds_listener_t *listener = dds_create_listener(echo);
        dds_lset_data_available(listener, echo_samples);
        dds_entity_t input_topic = dds_create_topic(participant, type, triple[1], NULL, NULL);
        if (dds_create_reader(participant, input_topic, qos, listener) < 0) return 5;
    }
    puts("ready");
    fflush(stdout);
    if (own_writer && is_latched) publish_joint_state(own_writer);
    struct pollfd standard_input = {.fd = 0, .events = POLLIN};
    while (!poll(&standard_input, 1, 100))
        if (own_writer && !is_latched) publish_joint_state(own_writer);
    dds_delete(participant);
    return 0;
}
