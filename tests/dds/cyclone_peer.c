/* A ROS 2 node's ends without ROS, on Cyclone's C library: sends back what it hears, and prints joint states.

   cyclone_peer DOMAIN reliable|best_effort volatile|latch [TYPE IN OUT]...
   TYPE is `sensor_msgs::msg::dds_::JointState_`. Where IN is `-`, it says one joint state on OUT ten times a second, or
   once and for late readers if it is to latch. It ends with its standard input. */
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

static void print(const sensor_msgs_msg_dds__JointState_ *state) {
    printf("took %d.%09u %s", state->header_.stamp_.sec_, state->header_.stamp_.nanosec_, state->header_.frame_id_);
    for (uint32_t i = 0; i < state->name_._length; i++) printf(" %s", state->name_._buffer[i]);
    for (uint32_t i = 0; i < state->position_._length; i++) printf(" %g", state->position_._buffer[i]);
    printf(" | %u %u\n", state->velocity_._length, state->effort_._length);
    fflush(stdout);
}

static void heard(dds_entity_t reader, void *arg) {
    struct echo *echo = arg;
    void *sample = NULL;
    dds_sample_info_t info;
    while (dds_take(reader, &sample, &info, 1, 1) == 1) {
        if (info.valid_data) {
            if (echo->joint_states) print(sample);
            if (dds_write(echo->writer, sample) < 0) puts("could not write");
        }
        dds_return_loan(reader, &sample, 1);
        sample = NULL;
    }
}

static void say(dds_entity_t writer) {
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

int main(int count, char **words) {
    if (count < 7) return 2;
    int reliable = !strcmp(words[2], "reliable"), latch = !strcmp(words[3], "latch");
    dds_entity_t participant = dds_create_participant((dds_domainid_t)atoi(words[1]), NULL, NULL);
    dds_qos_t *qos = dds_create_qos();
    if (reliable) dds_qset_reliability(qos, DDS_RELIABILITY_RELIABLE, DDS_SECS(1));
    else dds_qset_reliability(qos, DDS_RELIABILITY_BEST_EFFORT, 0);
    dds_qset_history(qos, DDS_HISTORY_KEEP_LAST, 1000);
    if (latch) {
        dds_qset_durability(qos, DDS_DURABILITY_TRANSIENT_LOCAL);
        dds_qset_durability_service(qos, 0, DDS_HISTORY_KEEP_LAST, 1, -1, -1, -1);
    }
    dds_entity_t says = 0;
    for (char **word = words + 4; word + 2 < words + count; word += 3) {
        const dds_topic_descriptor_t *type = type_of(word[0]);
        dds_entity_t out = dds_create_topic(participant, type, word[2], NULL, NULL);
        struct echo *echo = malloc(sizeof *echo);
        echo->joint_states = strstr(word[0], "JointState_") != NULL;
        echo->writer = dds_create_writer(participant, out, qos, NULL);
        if (echo->writer < 0) return 4;
        if (!strcmp(word[1], "-")) {
            says = echo->writer;
            continue;
        }
        dds_listener_t *listener = dds_create_listener(echo);
        dds_lset_data_available(listener, heard);
        dds_entity_t in = dds_create_topic(participant, type, word[1], NULL, NULL);
        if (dds_create_reader(participant, in, qos, listener) < 0) return 5;
    }
    puts("ready");
    fflush(stdout);
    if (says && latch) say(says);
    struct pollfd standard_input = {.fd = 0, .events = POLLIN};
    while (!poll(&standard_input, 1, 100))
        if (says && !latch) say(says);
    dds_delete(participant);
    return 0;
}
