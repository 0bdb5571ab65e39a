// The same as cyclone_peer.c on Fast DDS, ROS 2's default: sends back what it hears, and prints joint states.
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

static void print(const JointState &state) {
    const auto &stamp = state.header_().stamp_();
    std::printf("took %d.%09u %s", stamp.sec_(), stamp.nanosec_(), state.header_().frame_id_().c_str());
    for (const auto &name : state.name_()) std::printf(" %s", name.c_str());
    for (double position : state.position_()) std::printf(" %g", position);
    std::printf(" | %zu %zu\n", state.velocity_().size(), state.effort_().size());
    std::fflush(stdout);
}

static void say(DataWriter *writer) {
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
            if (joint_states) print(*static_cast<JointState *>(sample));
            if (!writer->write(sample)) std::puts("could not write");
        }
        type.delete_data(sample);
    }
};

static DomainParticipant *participant_of(int domain) {
    // Loopback only, without multicast: as rmw does it for ROS_LOCALHOST_ONLY.
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
    TypeSupport found;
    for (TopicDataType *known : std::vector<TopicDataType *>{PEER_TYPES}) {
        TypeSupport candidate(known);
        if (name == known->getName()) found = candidate;
    }
    if (found.empty()) std::exit(3);
    return found;
}

int main(int count, char **words) {
    if (count < 7) return 2;
    bool reliable = !std::strcmp(words[2], "reliable"), latch = !std::strcmp(words[3], "latch");
    DomainParticipant *participant = participant_of(std::atoi(words[1]));
    if (!participant) return 4;
    Publisher *publisher = participant->create_publisher(PUBLISHER_QOS_DEFAULT);
    Subscriber *subscriber = participant->create_subscriber(SUBSCRIBER_QOS_DEFAULT);

    DataWriterQos offered = DATAWRITER_QOS_DEFAULT;
    offered.reliability().kind = reliable ? RELIABLE_RELIABILITY_QOS : BEST_EFFORT_RELIABILITY_QOS;
    offered.durability().kind = latch ? TRANSIENT_LOCAL_DURABILITY_QOS : VOLATILE_DURABILITY_QOS;
    offered.history().depth = latch ? 1 : 1000;
    offered.data_sharing().off();  // it leaves files in /dev/shm when the process is killed
    DataReaderQos asked = DATAREADER_QOS_DEFAULT;
    asked.data_sharing().off();
    asked.reliability().kind = offered.reliability().kind;
    asked.durability().kind = offered.durability().kind;
    asked.history().depth = 1000;

    DataWriter *says = nullptr;
    std::vector<std::unique_ptr<Echo>> echoes;
    for (char **word = words + 4; word + 2 < words + count; word += 3) {
        TypeSupport type = type_of(word[0]);
        type.register_type(participant);
        Topic *out = participant->create_topic(word[2], word[0], TOPIC_QOS_DEFAULT);
        DataWriter *writer = publisher->create_datawriter(out, offered);
        if (!std::strcmp(word[1], "-")) {
            says = writer;
            continue;
        }
        echoes.push_back(std::make_unique<Echo>(writer, type, std::strstr(word[0], "JointState_") != nullptr));
        Topic *in = participant->create_topic(word[1], word[0], TOPIC_QOS_DEFAULT);
        subscriber->create_datareader(in, asked, echoes.back().get());
    }
    std::puts("ready");
    std::fflush(stdout);
    if (says && latch) say(says);
    pollfd standard_input{0, POLLIN, 0};
    while (!poll(&standard_input, 1, 100))
        if (says && !latch) say(says);
    participant->delete_contained_entities();
    DomainParticipantFactory::get_instance()->delete_participant(participant);
    return 0;
}
