// Does the same as cyclone_peer.c with Fast DDS, the default of ROS 2. The arguments and the output are equal.
#include <poll.h>
#include <cstdio>
#include <cstring>
#include <memory>
#include <string>
#include <vector>

#include <fastdds/dds/domain/DomainParticipant.hpp>
#include <fastdds/dds/domain/DomainParticipantFactory.hpp>
#include <fastdds/dds/publisher/DataWriter.hpp>
#include <fastdds/dds/publisher/Publisher.hpp>
#include <fastdds/dds/subscriber/DataReader.hpp>
#include <fastdds/dds/subscriber/DataReaderListener.hpp>
#include <fastdds/dds/subscriber/SampleInfo.hpp>
#include <fastdds/dds/subscriber/Subscriber.hpp>
#include <fastdds/rtps/transport/UDPv4TransportDescriptor.h>
#include <fastrtps/utils/IPLocator.h>

#include "peerPubSubTypes.h"

using namespace eprosima::fastdds::dds;
using JointState = sensor_msgs::msg::dds_::JointState_;

static void print_joint_state(const JointState &state) {
    const auto &stamp = state.header_().stamp_();
    std::printf("took %d.%09u %s", stamp.sec_(), stamp.nanosec_(), state.header_().frame_id_().c_str());
    for (const auto &name : state.name_()) std::printf(" %s", name.c_str());
    for (double position : state.position_()) std::printf(" %g", position);
    std::printf(" | %zu %zu\n", state.velocity_().size(), state.effort_().size());
    std::fflush(stdout);
}

static void publish_joint_state(DataWriter *writer) {
    JointState state;
    state.header_().stamp_().sec_(12);
    state.header_().stamp_().nanosec_(345678901);
    state.header_().frame_id_("base");
    state.name_({"shoulder", "elbow"});
    state.position_({0.5, -1.25});
    state.effort_({0.001});
    writer->write(&state);
}

struct Echo : DataReaderListener {
    DataWriter *writer;
    TypeSupport type;
    bool joint_states;

    Echo(DataWriter *writer, TypeSupport type, bool joint_states)
        : writer(writer), type(type), joint_states(joint_states) {}

    void on_data_available(DataReader *reader) override {
        void *sample = type.create_data();
        SampleInfo info;
        while (reader->take_next_sample(sample, &info) == ReturnCode_t::RETCODE_OK) {
            if (!info.valid_data) continue;
            if (joint_states) print_joint_state(*static_cast<JointState *>(sample));
            if (!writer->write(sample)) std::puts("could not write");
        }
        type.delete_data(sample);
    }
};

static DomainParticipant *participant_of(int domain) {
    // Use only the loopback interface and no multicast, as ROS 2's middleware does for ROS_LOCALHOST_ONLY.
    DomainParticipantQos qos;
    auto transport = std::make_shared<eprosima::fastdds::rtps::UDPv4TransportDescriptor>();
    transport->interfaceWhiteList = {"127.0.0.1"};
    qos.transport().use_builtin_transports = false;
    qos.transport().user_transports.push_back(transport);
    transport->maxInitialPeersRange = 10;
    eprosima::fastrtps::rtps::Locator_t peer;
    eprosima::fastrtps::rtps::IPLocator::setIPv4(peer, "127.0.0.1");
    qos.wire_protocol().builtin.initialPeersList.push_back(peer);
    return DomainParticipantFactory::get_instance()->create_participant(domain, qos);
}

static TypeSupport type_of(const std::string &name) {
    TypeSupport match;
    for (TopicDataType *type : std::vector<TopicDataType *>{PEER_TYPES}) {
        TypeSupport candidate(type);
        if (name == type->getName()) match = candidate;
    }
    if (match.empty()) std::exit(3);
    return match;
}

int main(int argc, char **argv) {
    if (argc < 7) return 2;
    bool is_reliable = !std::strcmp(argv[2], "reliable"), is_latched = !std::strcmp(argv[3], "latch");
    DomainParticipant *participant = participant_of(std::atoi(argv[1]));
    if (!participant) return 4;
    Publisher *publisher = participant->create_publisher(PUBLISHER_QOS_DEFAULT);
    Subscriber *subscriber = participant->create_subscriber(SUBSCRIBER_QOS_DEFAULT);

    DataWriterQos writer_qos = DATAWRITER_QOS_DEFAULT;
    writer_qos.reliability().kind = is_reliable ? RELIABLE_RELIABILITY_QOS : BEST_EFFORT_RELIABILITY_QOS;
    writer_qos.durability().kind = is_latched ? TRANSIENT_LOCAL_DURABILITY_QOS : VOLATILE_DURABILITY_QOS;
    writer_qos.history().depth = is_latched ? 1 : 1000;
    writer_qos.data_sharing().off();  // data sharing leaves files in /dev/shm when the process is killed
    DataReaderQos reader_qos = DATAREADER_QOS_DEFAULT;
    reader_qos.data_sharing().off();
    reader_qos.reliability().kind = writer_qos.reliability().kind;
    reader_qos.durability().kind = writer_qos.durability().kind;
    reader_qos.history().depth = 1000;

    DataWriter *own_writer = nullptr;
    std::vector<std::unique_ptr<Echo>> echoes;
    for (char **triple = argv + 4; triple + 2 < argv + argc; triple += 3) {
        TypeSupport type = type_of(triple[0]);
        type.register_type(participant);
        Topic *output_topic = participant->create_topic(triple[2], triple[0], TOPIC_QOS_DEFAULT);
        DataWriter *writer = publisher->create_datawriter(output_topic, writer_qos);
        if (!std::strcmp(triple[1], "-")) {
            own_writer = writer;
            continue;
        }
        echoes.push_back(std::make_unique<Echo>(writer, type, std::strstr(triple[0], "JointState_") != nullptr));
        Topic *input_topic = participant->create_topic(triple[1], triple[0], TOPIC_QOS_DEFAULT);
        subscriber->create_datareader(input_topic, reader_qos, echoes.back().get());
    }
    std::puts("ready");
    std::fflush(stdout);
    if (own_writer && is_latched) publish_joint_state(own_writer);
    pollfd standard_input{0, POLLIN, 0};
    while (!poll(&standard_input, 1, 100))
        if (own_writer && !is_latched) publish_joint_state(own_writer);
    participant->delete_contained_entities();
    DomainParticipantFactory::get_instance()->delete_participant(participant);
    return 0;
}
