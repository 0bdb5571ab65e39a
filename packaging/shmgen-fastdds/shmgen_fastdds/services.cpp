// Services of ROS 2, compatible with rmw_fastrtps. A service is a reader and a writer of Fast DDS. The inline QoS of
// each sample, which is metadata beside its bytes, identifies the call. This library does not interpret the bytes.
// hatch_build.py compiles this file against Fast DDS 2.9 to 3. __init__.py calls the functions at the end.
#include "versions.hpp"

#include <algorithm>
#include <condition_variable>
#include <cstdint>
#include <cstring>
#include <iterator>
#include <map>
#include <memory>
#include <mutex>
#include <set>
#include <shared_mutex>
#include <sstream>
#include <string>
#include <vector>

namespace {

// Maximum number of processes on one machine that Fast DDS discovers without multicast. rmw_fastrtps uses this number.
const unsigned MAX_PROCESSES = 32;

// The identity of a call: the GUID of the client's reader, which receives the reply, and a number. Older versions of
// rmw_fastrtps send the GUID of the client's writer instead.
struct Call {
    unsigned char guid[16];
    std::int64_t number;
};

// Copy a GUID to 16 bytes.
void copy_guid(const GUID_t &guid, unsigned char *bytes) {
    std::memcpy(bytes, guid.guidPrefix.value, 12);
    std::memcpy(bytes + 12, guid.entityId.value, 4);
}

GUID_t guid_from(const unsigned char *bytes) {
    GUID_t guid;
    std::memcpy(guid.guidPrefix.value, bytes, 12);
    std::memcpy(guid.entityId.value, bytes + 12, 4);
    return guid;
}

Call make_call(const GUID_t &guid, const rtps::SequenceNumber_t &number) {
    Call call;
    copy_guid(guid, call.guid);
    call.number = static_cast<std::int64_t>(number.to64long());
    return call;
}

// The reader and the writer of one service. Hold `lifetime_mutex` shared to use them, and exclusively to delete them.
// Fast DDS calls the listeners, which lock `mutex`. To prevent a deadlock, never call a blocking function of Fast DDS
// while holding `mutex`.
struct Pair : DataReaderListener, DataWriterListener {
    struct Domain *domain = nullptr;
    std::shared_mutex lifetime_mutex;
    DataReader *reader = nullptr;
    DataWriter *writer = nullptr;
    std::mutex mutex;                       // protects the fields below
    std::condition_variable state_changed;  // notified after each change of the next two lines
    unsigned arrivals = 0;                  // number of notifications of new samples
    bool peers_changed = false, is_closing = false;
    std::set<GUID_t> peer_writers, peer_readers;

    void on_data_available(DataReader *) override {
        std::lock_guard<std::mutex> guard(mutex);
        arrivals++;
        state_changed.notify_all();
    }
    void on_subscription_matched(DataReader *, const SubscriptionMatchedStatus &status) override {
        update_peers(peer_writers, status.last_publication_handle, status.current_count_change);
    }
    void on_publication_matched(DataWriter *, const PublicationMatchedStatus &status) override {
        update_peers(peer_readers, status.last_subscription_handle, status.current_count_change);
    }
    void update_peers(std::set<GUID_t> &peers, const rtps::InstanceHandle_t &handle, int change) {
        std::lock_guard<std::mutex> guard(mutex);
        if (change > 0) peers.insert(rtps::iHandle2GUID(handle));
        if (change < 0) peers.erase(rtps::iHandle2GUID(handle));
        peers_changed = true;
        state_changed.notify_all();
    }
};

// The DDS participant and its services. Hold `lifetime_mutex` to open or close a Pair, or to leave the domain. A closed
// Pair stays in memory, because a thread may still call its functions.
struct Domain : DomainParticipantListener {
    std::mutex lifetime_mutex;
    DomainParticipant *participant = nullptr;
    Publisher *publisher = nullptr;
    Subscriber *subscriber = nullptr;
    std::uint32_t max_message_size = 0;  // bytes
    std::vector<std::unique_ptr<Pair>> pairs;
    std::mutex mutex;                         // protects `user_data`
    std::map<GUID_t, std::string> user_data;  // of each discovered reader and writer of services

#if FAST_DDS_3
    void on_data_writer_discovery(DomainParticipant *, rtps::WriterDiscoveryStatus status,
                                  const PublicationBuiltinTopicData &peer, bool &ignored) override {
        ignored = false;
        store_user_data(peer.guid, peer.topic_name.to_string(), peer.user_data,
                        status == rtps::WriterDiscoveryStatus::REMOVED_WRITER);
    }
    void on_data_reader_discovery(DomainParticipant *, rtps::ReaderDiscoveryStatus status,
                                  const SubscriptionBuiltinTopicData &peer, bool &ignored) override {
        ignored = false;
        store_user_data(peer.guid, peer.topic_name.to_string(), peer.user_data,
                        status == rtps::ReaderDiscoveryStatus::REMOVED_READER);
    }
#else
    void on_publisher_discovery(DomainParticipant *, rtps::WriterDiscoveryInfo &&peer) override {
        store_user_data(peer.info.guid(), peer.info.topicName().to_string(), peer.info.m_qos.m_userData,
                        peer.status == rtps::WriterDiscoveryInfo::REMOVED_WRITER);
    }
    void on_subscriber_discovery(DomainParticipant *, rtps::ReaderDiscoveryInfo &&peer) override {
        store_user_data(peer.info.guid(), peer.info.topicName().to_string(), peer.info.m_qos.m_userData,
                        peer.status == rtps::ReaderDiscoveryInfo::REMOVED_READER);
    }
#endif
    // Store the user data of a reader or writer of services, or delete the user data if the peer was removed.
    void store_user_data(const GUID_t &guid, const std::string &topic, const std::vector<rtps::octet> &bytes,
                         bool is_removed) {
        if (topic.compare(0, 3, "rq/") && topic.compare(0, 3, "rr/")) return;  // not a topic of a service
        std::lock_guard<std::mutex> guard(mutex);
        user_data.erase(guid);
        if (!is_removed) user_data.emplace(guid, std::string(bytes.begin(), bytes.end()));
    }
};

std::vector<std::string> split_at_spaces(const char *text) {
    std::istringstream words(text);
    return {std::istream_iterator<std::string>(words), {}};
}

// Return the QoS of the participant. `peers` and `interfaces` are those of `fast_join`.
DomainParticipantQos participant_qos(const char *peers, const char *interfaces) {
    auto *factory = DomainParticipantFactory::get_instance();
    factory->load_profiles();
    DomainParticipantQos qos = factory->get_default_participant_qos();
    auto &discovery = qos.wire_protocol().builtin;
    discovery.readerHistoryMemoryPolicy = rtps::PREALLOCATED_WITH_REALLOC_MEMORY_MODE;
    discovery.writerHistoryMemoryPolicy = rtps::PREALLOCATED_WITH_REALLOC_MEMORY_MODE;
    if (qos.transport().user_transports.empty()) {  // otherwise an XML profile of the user has defined them
        auto transport = std::make_shared<Transport>();
        transport->maxInitialPeersRange = MAX_PROCESSES;
        transport->interfaceWhiteList = split_at_spaces(interfaces);
        qos.transport().use_builtin_transports = false;  // the shared-memory transport leaves files in /dev/shm
        qos.transport().user_transports.push_back(transport);
    }
    if (*interfaces) {  // disable multicast: discovery uses only unicast
        discovery.metatrafficMulticastLocatorList.clear();
        discovery.metatrafficUnicastLocatorList.push_back(rtps::Locator_t());
    }
    for (const std::string &peer : split_at_spaces(peers)) {
        rtps::Locator_t locator;
        rtps::IPLocator::setIPv4(locator, peer);
        discovery.initialPeersList.push_back(locator);
    }
    return qos;
}

// Set the QoS of a reader or writer of a service. `depth` is the maximum number of samples in its queue.
template <typename EndpointQos> void set_service_qos(EndpointQos &qos, const char *user_data, int depth) {
    qos.reliability().kind = RELIABLE_RELIABILITY_QOS;
    qos.durability().kind = VOLATILE_DURABILITY_QOS;
    qos.history().kind = KEEP_LAST_HISTORY_QOS;
    qos.history().depth = depth;
    qos.resource_limits().max_instances = 1;
    qos.resource_limits().max_samples = depth;
    qos.resource_limits().max_samples_per_instance = depth;
    qos.resource_limits().allocated_samples = 1;
    qos.user_data().data_vec({user_data, user_data + std::strlen(user_data)});
    qos.data_sharing().off();
}

// Return the topic `name`, and create it if necessary. Return NULL on failure.
Topic *find_or_create_topic(Domain &domain, const char *name, const char *type) {
    if (domain.participant->find_type(type).empty())
        TypeSupport(new OpaqueType(type, domain.max_message_size)).register_type(domain.participant);
    if (auto *topic = dynamic_cast<Topic *>(domain.participant->lookup_topicdescription(name))) return topic;
    return domain.participant->create_topic(name, type, TOPIC_QOS_DEFAULT);
}

// Wait until no thread uses the reader and the writer, and delete them.
void close(Domain &domain, Pair &pair) {
    {
        std::lock_guard<std::mutex> guard(pair.mutex);
        pair.is_closing = true;
        pair.state_changed.notify_all();
    }
    std::unique_lock<std::shared_mutex> exclusive(pair.lifetime_mutex);
    if (pair.reader) domain.subscriber->delete_datareader(pair.reader);
    if (pair.writer) domain.publisher->delete_datawriter(pair.writer);
    pair.reader = nullptr;
    pair.writer = nullptr;
    std::lock_guard<std::mutex> guard(pair.mutex);
    pair.peer_writers.clear();
    pair.peer_readers.clear();
}

// Call `body`, and return `failure` if it throws: no exception may leave this library, because its caller is C code.
template <typename Result, typename Body> Result without_exceptions(Result failure, Body body) {
    try {
        return body();
    } catch (...) {
        return failure;
    }
}

}  // namespace

extern "C" {

// Join a domain. `peers` and `interfaces` are IPv4 addresses, separated by spaces. If interfaces are listed, the
// participant uses only these interfaces, without multicast. Return NULL on failure.
void *fast_join(int number, const char *name, const char *peers, const char *interfaces,
                std::uint32_t max_message_size) {
    return without_exceptions<void *>(nullptr, [&]() -> void * {
        auto domain = std::make_unique<Domain>();
        domain->max_message_size = max_message_size;
        DomainParticipantQos qos = participant_qos(peers, interfaces);
        qos.name(name);
        domain->participant = DomainParticipantFactory::get_instance()->create_participant(
            number, qos, domain.get(), StatusMask::none());
        if (!domain->participant) return nullptr;
        domain->publisher = domain->participant->create_publisher(PUBLISHER_QOS_DEFAULT);
        domain->subscriber = domain->participant->create_subscriber(SUBSCRIBER_QOS_DEFAULT);
        return domain.release();
    });
}

// Create the reader and the writer of a service. `reader` and `writer` each contain a topic, a type and user data.
// `depth` is the maximum number of samples in a queue. Return NULL on failure.
void *fast_open(void *domain_handle, const char *const *reader, const char *const *writer, int depth) {
    return without_exceptions<void *>(nullptr, [&]() -> void * {
        auto &domain = *static_cast<Domain *>(domain_handle);
        std::lock_guard<std::mutex> guard(domain.lifetime_mutex);
        if (!domain.participant) return nullptr;
        Topic *read_topic = find_or_create_topic(domain, reader[0], reader[1]);
        Topic *written_topic = find_or_create_topic(domain, writer[0], writer[1]);
        if (!read_topic || !written_topic) return nullptr;
        auto pair = std::make_unique<Pair>();
        pair->domain = &domain;
        DataReaderQos reader_qos = DATAREADER_QOS_DEFAULT;
        set_service_qos(reader_qos, reader[2], depth);
        resend_at_once(reader_qos);
        reader_qos.endpoint().history_memory_policy = rtps::PREALLOCATED_MEMORY_MODE;  // drops larger messages
        DataWriterQos writer_qos = DATAWRITER_QOS_DEFAULT;
        set_service_qos(writer_qos, writer[2], depth);
        resend_at_once(writer_qos);
        writer_qos.endpoint().history_memory_policy = rtps::DYNAMIC_RESERVE_MEMORY_MODE;
        pair->writer = domain.publisher->create_datawriter(written_topic, writer_qos, pair.get(),
                                                           StatusMask::publication_matched());
        pair->reader = domain.subscriber->create_datareader(
            read_topic, reader_qos, pair.get(), StatusMask::subscription_matched() << StatusMask::data_available());
        domain.pairs.push_back(std::move(pair));
        return domain.pairs.back().get();
    });
}

// Wait for a request or a reply, and copy it into `buffer`. Fill in `sender` (a GUID of 16 bytes) and `call`.
// Return the size in bytes, 0 if the peers have changed, or -1 if the service is closed.
int fast_take(void *pair_handle, void *buffer, std::uint32_t capacity, unsigned char *sender, Call *call) {
    return without_exceptions<int>(-1, [&] {
        auto &pair = *static_cast<Pair *>(pair_handle);
        std::shared_lock<std::shared_mutex> shared(pair.lifetime_mutex);
        std::unique_lock<std::mutex> lock(pair.mutex);
        while (!pair.is_closing) {
            if (pair.peers_changed) {
                pair.peers_changed = false;
                return 0;
            }
            const unsigned arrivals = pair.arrivals;
            lock.unlock();  // Fast DDS holds its own lock when it calls a listener, and acquires it in the next call
            Bytes message{static_cast<unsigned char *>(buffer), capacity, 0};
            SampleInfo info;
            auto result = pair.reader->take_next_sample(&message, &info);
            if (result == OK && info.valid_data && message.size) {
                auto &related = info.related_sample_identity;
                const bool is_request = related.sequence_number() <= rtps::SequenceNumber_t();
                GUID_t guid = related.writer_guid();
                if (is_request && guid == GUID_t::unknown()) guid = info.sample_identity.writer_guid();
                if (!is_request && guid == pair.writer->guid()) guid = pair.reader->guid();
                *call = make_call(
                    guid, is_request ? info.sample_identity.sequence_number() : related.sequence_number());
                copy_guid(info.sample_identity.writer_guid(), sender);
                return static_cast<int>(message.size);
            }
            lock.lock();
            if (result != OK)
                pair.state_changed.wait(
                    lock, [&] { return pair.is_closing || pair.peers_changed || pair.arrivals != arrivals; });
        }
        return -1;
    });
}

// If `call` is not NULL, send the reply to `call`. Otherwise, send a request. Fill in `sent_call`, the identity that
// the reply to this request will contain. Return 0 on failure.
int fast_send(void *pair_handle, void *bytes, std::uint32_t size, const Call *call, Call *sent_call) {
    return without_exceptions<int>(0, [&] {
        auto &pair = *static_cast<Pair *>(pair_handle);
        std::shared_lock<std::shared_mutex> shared(pair.lifetime_mutex);
        if (!pair.writer) return 1;  // the service is closed: no error
        rtps::WriteParams parameters;
        if (call) {
            parameters.related_sample_identity().writer_guid() = guid_from(call->guid);
            parameters.related_sample_identity().sequence_number() = rtps::SequenceNumber_t(call->number);
        } else {  // the server needs this GUID to check that it has discovered our reader
            parameters.related_sample_identity().writer_guid() = pair.reader->guid();
        }
        Bytes message{static_cast<unsigned char *>(bytes), size, size};
        const bool is_written = is_ok(pair.writer->write(&message, parameters));
        *sent_call = make_call(pair.reader->guid(), parameters.sample_identity().sequence_number());
        return static_cast<int>(is_written);
    });
}

// Store the GUIDs, 16 bytes each, of the peer readers (if `readers` is not 0) or of the peer writers. Return the number
// of peers, which may exceed `capacity`, the number of GUIDs for which there is memory.
int fast_peers(void *pair_handle, int readers, unsigned char *guids, int capacity) {
    auto &pair = *static_cast<Pair *>(pair_handle);
    std::lock_guard<std::mutex> guard(pair.mutex);
    auto &peers = readers ? pair.peer_readers : pair.peer_writers;
    for (auto &guid : peers)
        if (capacity-- > 0) copy_guid(guid, guids), guids += 16;
    return static_cast<int>(peers.size());
}

// Copy the user data of a peer into `buffer`. Return its length in bytes, which may exceed `capacity`, or -1 if the
// peer has left.
int fast_user_data(void *pair_handle, const unsigned char *guid, char *buffer, int capacity) {
    auto &domain = *static_cast<Pair *>(pair_handle)->domain;
    std::lock_guard<std::mutex> guard(domain.mutex);
    auto entry = domain.user_data.find(guid_from(guid));
    if (entry == domain.user_data.end()) return -1;
    std::memcpy(buffer, entry->second.data(), std::min<std::size_t>(capacity, entry->second.size()));
    return static_cast<int>(entry->second.size());
}

// Close a service: delete its reader and its writer. Later calls of the functions above report that it is closed.
void fast_close(void *pair_handle) {
    without_exceptions<int>(0, [&] {
        auto &pair = *static_cast<Pair *>(pair_handle);
        std::lock_guard<std::mutex> guard(pair.domain->lifetime_mutex);
        if (pair.domain->participant) close(*pair.domain, pair);
        return 0;
    });
}

// Leave the domain and close all its services. Later calls of the functions above report that a service is closed.
void fast_leave(void *domain_handle) {
    without_exceptions<int>(0, [&] {
        auto &domain = *static_cast<Domain *>(domain_handle);
        std::lock_guard<std::mutex> guard(domain.lifetime_mutex);
        if (!domain.participant) return 0;
        for (auto &pair : domain.pairs) close(domain, *pair);
        domain.participant->delete_contained_entities();
        DomainParticipantFactory::get_instance()->delete_participant(domain.participant);
        domain.participant = nullptr;
        return 0;
    });
}
}
