// Names that differ between Fast DDS 2 and 3, and the data type that services.cpp registers with either version.
#pragma once

#include <fastdds/dds/domain/DomainParticipant.hpp>
#include <fastdds/dds/domain/DomainParticipantFactory.hpp>
#include <fastdds/dds/domain/DomainParticipantListener.hpp>
#include <fastdds/dds/publisher/DataWriter.hpp>
#include <fastdds/dds/publisher/DataWriterListener.hpp>
#include <fastdds/dds/publisher/Publisher.hpp>
#include <fastdds/dds/subscriber/DataReader.hpp>
#include <fastdds/dds/subscriber/DataReaderListener.hpp>
#include <fastdds/dds/subscriber/SampleInfo.hpp>
#include <fastdds/dds/subscriber/Subscriber.hpp>
#include <fastdds/dds/topic/TopicDataType.hpp>
#if __has_include(<fastdds/rtps/transport/UDPv4TransportDescriptor.hpp>)
#include <fastdds/rtps/common/WriteParams.hpp>
#include <fastdds/rtps/transport/UDPv4TransportDescriptor.hpp>
#include <fastdds/utils/IPLocator.hpp>
#define FAST_DDS_3 1
#else
#include <fastdds/rtps/common/WriteParams.h>
#include <fastdds/rtps/transport/UDPv4TransportDescriptor.h>
#include <fastrtps/utils/IPLocator.h>
#define FAST_DDS_3 0
#endif

#include <cstdint>
#include <cstring>
#include <functional>
#include <string>

namespace {

using namespace eprosima::fastdds::dds;
// Nanoseconds between two heartbeats of a writer while a reader has not acknowledged all samples.
const std::uint32_t HEARTBEAT_PERIOD = 20'000'000;
#if FAST_DDS_3
namespace rtps = eprosima::fastdds::rtps;
const auto OK = RETCODE_OK;
bool is_ok(ReturnCode_t code) { return code == OK; }
#else
namespace rtps = eprosima::fastrtps::rtps;
const ReturnCode_t OK = ReturnCode_t::RETCODE_OK;
bool is_ok(bool is_written) { return is_written; }
#endif
// Make the writer resend lost samples at once. With the default times, a repetition takes 3 s, and later calls wait.
void resend_at_once(DataWriterQos &qos) {
    auto &times = qos.reliable_writer_qos().times;
#if FAST_DDS_3
    times.heartbeat_period = {0, HEARTBEAT_PERIOD};
    times.nack_response_delay = {0, 0};
#else
    times.heartbeatPeriod = {0, HEARTBEAT_PERIOD};
    times.nackResponseDelay = {0, 0};
#endif
}
void resend_at_once(DataReaderQos &qos) {
    auto &times = qos.reliable_reader_qos().times;
#if FAST_DDS_3
    times.heartbeat_response_delay = {0, 0};
#else
    times.heartbeatResponseDelay = {0, 0};
#endif
}
using Transport = eprosima::fastdds::rtps::UDPv4TransportDescriptor;
using rtps::GUID_t;

// A buffer of `capacity` bytes that contains `size` bytes of a message.
struct Bytes {
    unsigned char *data;
    std::uint32_t capacity, size;
};

// The data type of all messages: opaque bytes, which Python encodes and decodes.
struct OpaqueType : TopicDataType {
    bool pack(const Bytes &bytes, rtps::SerializedPayload_t &payload) {
        if (bytes.size > payload.max_size) return false;
        std::memcpy(payload.data, bytes.data, bytes.size);
        payload.length = bytes.size;
        payload.encapsulation = CDR_LE;
        return true;
    }
    bool unpack(const rtps::SerializedPayload_t &payload, Bytes &bytes) {
        if (payload.length > bytes.capacity) return false;
        std::memcpy(bytes.data, payload.data, payload.length);
        bytes.size = payload.length;
        return true;
    }
#if FAST_DDS_3
    OpaqueType(const std::string &name, std::uint32_t max_size) {
        set_name(name);
        max_serialized_type_size = max_size;
    }
    bool serialize(const void *const data, rtps::SerializedPayload_t &payload, DataRepresentationId_t) override {
        return pack(*static_cast<const Bytes *>(data), payload);
    }
    bool deserialize(rtps::SerializedPayload_t &payload, void *data) override {
        return unpack(payload, *static_cast<Bytes *>(data));
    }
    std::uint32_t calculate_serialized_size(const void *const data, DataRepresentationId_t) override {
        return static_cast<const Bytes *>(data)->size;
    }
    void *create_data() override { return new Bytes(); }
    void delete_data(void *data) override { delete static_cast<Bytes *>(data); }
    bool compute_key(rtps::SerializedPayload_t &, rtps::InstanceHandle_t &, bool) override { return false; }
    bool compute_key(const void *const, rtps::InstanceHandle_t &, bool) override { return false; }
#else
    OpaqueType(const std::string &name, std::uint32_t max_size) {
        setName(name.c_str());
        m_typeSize = max_size;
        auto_fill_type_object(false);
        auto_fill_type_information(false);
    }
    bool serialize(void *data, rtps::SerializedPayload_t *payload) override {
        return pack(*static_cast<Bytes *>(data), *payload);
    }
    bool deserialize(rtps::SerializedPayload_t *payload, void *data) override {
        return unpack(*payload, *static_cast<Bytes *>(data));
    }
    std::function<std::uint32_t()> getSerializedSizeProvider(void *data) override {
        return [data] { return static_cast<Bytes *>(data)->size; };
    }
    void *createData() override { return new Bytes(); }
    void deleteData(void *data) override { delete static_cast<Bytes *>(data); }
    bool getKey(void *, rtps::InstanceHandle_t *, bool) override { return false; }
#endif
};

}  // namespace
