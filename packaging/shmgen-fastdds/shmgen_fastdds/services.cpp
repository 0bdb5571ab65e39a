// Services of ROS 2, compatible with rmw_fastrtps: a reader and a writer of Fast DDS, with the inline QoS that
// identifies the call of a sample. Bytes pass through unread. hatch_build.py compiles this file against Fast DDS 2.9
// to 3. __init__.py calls the functions at the end.
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

// Maximum number of processes on one machine that are found without multicast. rmw_fastrtps uses the same.
const unsigned PROCESSES = 32;

// The identity of a call: the GUID of the reader that receives the reply, and a number. Older versions send the GUID of
// the client's writer.
struct Call {
    unsigned char guid[16];
    std::int64_t number;
};

void copy(const GUID_t &guid, unsigned char *to) {
    std::memcpy(to, guid.guidPrefix.value, 12);
    std::memcpy(to + 12, guid.entityId.value, 4);
}

GUID_t guid_of(const unsigned char *from) {
    GUID_t guid;
    std::memcpy(guid.guidPrefix.value, from, 12);
    std::memcpy(guid.entityId.value, from + 12, 4);
    return guid;
}

Call call_of(const GUID_t &guid, const rtps::SequenceNumber_t &number) {
    Call found;
    copy(guid, found.guid);
    found.number = static_cast<std::int64_t>(number.to64long());
    return found;
}

// The reader and the writer of one service. Hold `life` shared to use them, and exclusively to delete them. Fast DDS
// calls the listeners, which lock `mutex`: never call a blocking function of Fast DDS while holding `mutex`.
struct End : DataReaderListener, DataWriterListener {
    struct Domain *domain = nullptr;
    std::shared_mutex life;
    DataReader *reader = nullptr;
    DataWriter *writer = nullptr;
    std::mutex mutex;
    std::condition_variable news;
    unsigned came = 0;
    bool met = false, closing = false;
    std::set<GUID_t> heard, hearing;

    void on_data_available(DataReader *) override {
        std::lock_guard<std::mutex> hold(mutex);
        came++;
        news.notify_all();
    }
    void on_subscription_matched(DataReader *, const SubscriptionMatchedStatus &status) override {
        note(heard, status.last_publication_handle, status.current_count_change);
    }
    void on_publication_matched(DataWriter *, const PublicationMatchedStatus &status) override {
        note(hearing, status.last_subscription_handle, status.current_count_change);
    }
    void note(std::set<GUID_t> &peers, const rtps::InstanceHandle_t &handle, int change) {
        std::lock_guard<std::mutex> hold(mutex);
        if (change > 0) peers.insert(rtps::iHandle2GUID(handle));
        if (change < 0) peers.erase(rtps::iHandle2GUID(handle));
        met = true;
        news.notify_all();
    }
};

// Hold `life` to open or close an End, or to leave. Closed Ends stay in memory, because a thread may still call them.
struct Domain : DomainParticipantListener {
    std::mutex life;
    DomainParticipant *participant = nullptr;
    Publisher *publisher = nullptr;
    Subscriber *subscriber = nullptr;
    std::uint32_t largest = 0;
    std::mutex mutex;
    std::vector<std::unique_ptr<End>> ends;
    std::map<GUID_t, std::string> said;

#if FAST_DDS_3
    void on_data_writer_discovery(DomainParticipant *, rtps::WriterDiscoveryStatus status,
                                  const PublicationBuiltinTopicData &peer, bool &ignored) override {
        ignored = false;
        keep(peer.guid, peer.topic_name.to_string(), peer.user_data,
             status == rtps::WriterDiscoveryStatus::REMOVED_WRITER);
    }
    void on_data_reader_discovery(DomainParticipant *, rtps::ReaderDiscoveryStatus status,
                                  const SubscriptionBuiltinTopicData &peer, bool &ignored) override {
        ignored = false;
        keep(peer.guid, peer.topic_name.to_string(), peer.user_data,
             status == rtps::ReaderDiscoveryStatus::REMOVED_READER);
    }
#else
    void on_publisher_discovery(DomainParticipant *, rtps::WriterDiscoveryInfo &&peer) override {
        keep(peer.info.guid(), peer.info.topicName().to_string(), peer.info.m_qos.m_userData,
             peer.status == rtps::WriterDiscoveryInfo::REMOVED_WRITER);
    }
    void on_subscriber_discovery(DomainParticipant *, rtps::ReaderDiscoveryInfo &&peer) override {
        keep(peer.info.guid(), peer.info.topicName().to_string(), peer.info.m_qos.m_userData,
             peer.status == rtps::ReaderDiscoveryInfo::REMOVED_READER);
    }
#endif
    void keep(const GUID_t &guid, const std::string &topic, const std::vector<rtps::octet> &words, bool gone) {
        if (topic.compare(0, 3, "rq/") && topic.compare(0, 3, "rr/")) return;  // not a topic of a service
        std::lock_guard<std::mutex> hold(mutex);
        said.erase(guid);
        if (!gone) said.emplace(guid, std::string(words.begin(), words.end()));
    }
};

std::vector<std::string> words_of(const char *text) {
    std::istringstream words(text);
    return {std::istream_iterator<std::string>(words), {}};
}

DomainParticipantQos quality_of(const char *peers, const char *interfaces) {
    auto *factory = DomainParticipantFactory::get_instance();
    factory->load_profiles();
    DomainParticipantQos quality = factory->get_default_participant_qos();
    auto &discovery = quality.wire_protocol().builtin;
    discovery.readerHistoryMemoryPolicy = rtps::PREALLOCATED_WITH_REALLOC_MEMORY_MODE;
    discovery.writerHistoryMemoryPolicy = rtps::PREALLOCATED_WITH_REALLOC_MEMORY_MODE;
    if (quality.transport().user_transports.empty()) {  // otherwise a profile of the user defines them
        auto transport = std::make_shared<Transport>();
        transport->maxInitialPeersRange = PROCESSES;
        transport->interfaceWhiteList = words_of(interfaces);
        quality.transport().use_builtin_transports = false;  // one of them leaves files in /dev/shm
        quality.transport().user_transports.push_back(transport);
    }
    if (*interfaces) {  // no multicast
        discovery.metatrafficMulticastLocatorList.clear();
        discovery.metatrafficUnicastLocatorList.push_back(rtps::Locator_t());
    }
    for (const std::string &peer : words_of(peers)) {
        rtps::Locator_t locator;
        rtps::IPLocator::setIPv4(locator, peer);
        discovery.initialPeersList.push_back(locator);
    }
    return quality;
}

template <typename Quality> void adapt(Quality &quality, const char *words, int queue) {
    quality.reliability().kind = RELIABLE_RELIABILITY_QOS;
    quality.durability().kind = VOLATILE_DURABILITY_QOS;
    quality.history().kind = KEEP_LAST_HISTORY_QOS;
    quality.history().depth = queue;
    quality.resource_limits().max_instances = 1;
    quality.resource_limits().max_samples = queue;
    quality.resource_limits().max_samples_per_instance = queue;
    quality.resource_limits().allocated_samples = 1;
    quality.user_data().data_vec({words, words + std::strlen(words)});
    quality.data_sharing().off();
}

Topic *topic_of(Domain &domain, const char *name, const char *type) {
    if (domain.participant->find_type(type).empty())
        TypeSupport(new Raw(type, domain.largest)).register_type(domain.participant);
    if (auto *found = dynamic_cast<Topic *>(domain.participant->lookup_topicdescription(name))) return found;
    return domain.participant->create_topic(name, type, TOPIC_QOS_DEFAULT);
}

// Deletes the reader and the writer, once no thread uses them any more.
void close(Domain &domain, End &end) {
    {
        std::lock_guard<std::mutex> hold(end.mutex);
        end.closing = true;
        end.news.notify_all();
    }
    std::unique_lock<std::shared_mutex> last(end.life);
    if (end.reader) domain.subscriber->delete_datareader(end.reader);
    if (end.writer) domain.publisher->delete_datawriter(end.writer);
    end.reader = nullptr;
    end.writer = nullptr;
    std::lock_guard<std::mutex> hold(end.mutex);
    end.heard.clear();
    end.hearing.clear();
}

// Returns `failed` if the body throws: no exception may leave this library.
template <typename Result, typename Body> Result guarded(Result failed, Body body) {
    try {
        return body();
    } catch (...) {
        return failed;
    }
}

}  // namespace

extern "C" {

// Joins a domain. `peers` and `interfaces` are IPv4 addresses, separated by spaces. If interfaces are listed, only they
// are used, without multicast. Returns NULL on failure.
void *fast_join(int number, const char *name, const char *peers, const char *interfaces, std::uint32_t largest) {
    return guarded<void *>(nullptr, [&]() -> void * {
        auto domain = std::make_unique<Domain>();
        domain->largest = largest;
        DomainParticipantQos quality = quality_of(peers, interfaces);
        quality.name(name);
        domain->participant = DomainParticipantFactory::get_instance()->create_participant(
            number, quality, domain.get(), StatusMask::none());
        if (!domain->participant) return nullptr;
        domain->publisher = domain->participant->create_publisher(PUBLISHER_QOS_DEFAULT);
        domain->subscriber = domain->participant->create_subscriber(SUBSCRIBER_QOS_DEFAULT);
        return domain.release();
    });
}

// Creates a reader (`hears`) and a writer (`says`). Each array contains topic, type and user data. Returns NULL on
// failure.
void *fast_open(void *of, const char *const *hears, const char *const *says, int queue) {
    return guarded<void *>(nullptr, [&]() -> void * {
        auto &domain = *static_cast<Domain *>(of);
        std::lock_guard<std::mutex> opening(domain.life);
        if (!domain.participant) return nullptr;
        Topic *heard = topic_of(domain, hears[0], hears[1]), *said = topic_of(domain, says[0], says[1]);
        if (!heard || !said) return nullptr;
        auto end = std::make_unique<End>();
        end->domain = &domain;
        DataReaderQos asked = DATAREADER_QOS_DEFAULT;
        adapt(asked, hears[2], queue);
        promptly(asked);
        asked.endpoint().history_memory_policy = rtps::PREALLOCATED_MEMORY_MODE;  // larger messages are dropped
        DataWriterQos offered = DATAWRITER_QOS_DEFAULT;
        adapt(offered, says[2], queue);
        promptly(offered);
        offered.endpoint().history_memory_policy = rtps::DYNAMIC_RESERVE_MEMORY_MODE;
        end->writer = domain.publisher->create_datawriter(said, offered, end.get(), StatusMask::publication_matched());
        end->reader = domain.subscriber->create_datareader(
            heard, asked, end.get(), StatusMask::subscription_matched() << StatusMask::data_available());
        domain.ends.push_back(std::move(end));
        return domain.ends.back().get();
    });
}

// Waits for a request or a reply, and fills in `sender` and `call`. Returns its size in bytes, 0 if the peers have
// changed, or -1 if the service is closed.
int fast_take(void *of, void *bytes, std::uint32_t room, unsigned char *sender, Call *call) {
    return guarded<int>(-1, [&] {
        auto &end = *static_cast<End *>(of);
        std::shared_lock<std::shared_mutex> alive(end.life);
        std::unique_lock<std::mutex> hold(end.mutex);
        while (!end.closing) {
            if (end.met) {
                end.met = false;
                return 0;
            }
            unsigned seen = end.came;
            hold.unlock();  // Fast DDS calls listeners with its own lock held, and takes that lock below
            Bytes taken{static_cast<unsigned char *>(bytes), room, 0};
            SampleInfo info;
            auto found = end.reader->take_next_sample(&taken, &info);
            if (found == OK && info.valid_data && taken.size) {
                auto &related = info.related_sample_identity;
                bool asks = related.sequence_number() <= rtps::SequenceNumber_t();
                GUID_t guid = related.writer_guid();
                if (asks && guid == GUID_t::unknown()) guid = info.sample_identity.writer_guid();
                if (!asks && guid == end.writer->guid()) guid = end.reader->guid();
                *call = call_of(guid, asks ? info.sample_identity.sequence_number() : related.sequence_number());
                copy(info.sample_identity.writer_guid(), sender);
                return static_cast<int>(taken.size);
            }
            hold.lock();
            if (found != OK) end.news.wait(hold, [&] { return end.closing || end.met || end.came != seen; });
        }
        return -1;
    });
}

// Sends the reply to `call`. If `call` is NULL, sends a request and fills in `sent`, which the reply will repeat.
// Returns 0 on failure.
int fast_send(void *of, void *bytes, std::uint32_t size, const Call *call, Call *sent) {
    return guarded<int>(0, [&] {
        auto &end = *static_cast<End *>(of);
        std::shared_lock<std::shared_mutex> alive(end.life);
        if (!end.writer) return 1;  // the service is closed: no error
        rtps::WriteParams whose;
        if (call) {
            whose.related_sample_identity().writer_guid() = guid_of(call->guid);
            whose.related_sample_identity().sequence_number() = rtps::SequenceNumber_t(call->number);
        } else {  // lets the server check that our reader is discovered
            whose.related_sample_identity().writer_guid() = end.reader->guid();
        }
        Bytes message{static_cast<unsigned char *>(bytes), size, size};
        bool done = written(end.writer->write(&message, whose));
        *sent = call_of(end.reader->guid(), whose.sample_identity().sequence_number());
        return static_cast<int>(done);
    });
}

// Stores the GUIDs, 16 bytes each, of the peer readers (`hearing`) or peer writers. Returns the number of peers, which
// may exceed `room`.
int fast_peers(void *of, int hearing, unsigned char *found, int room) {
    auto &end = *static_cast<End *>(of);
    std::lock_guard<std::mutex> hold(end.mutex);
    auto &peers = hearing ? end.hearing : end.heard;
    for (auto &guid : peers)
        if (room-- > 0) copy(guid, found), found += 16;
    return static_cast<int>(peers.size());
}

// Copies the user data of a peer. Returns its length in bytes, or -1 if the peer has left.
int fast_said(void *of, const unsigned char *guid, char *words, int room) {
    auto &domain = *static_cast<End *>(of)->domain;
    std::lock_guard<std::mutex> hold(domain.mutex);
    auto found = domain.said.find(guid_of(guid));
    if (found == domain.said.end()) return -1;
    std::memcpy(words, found->second.data(), std::min<std::size_t>(room, found->second.size()));
    return static_cast<int>(found->second.size());
}

// Removes a service from the graph.
void fast_close(void *of) {
    guarded<int>(0, [&] {
        auto &end = *static_cast<End *>(of);
        std::lock_guard<std::mutex> closing(end.domain->life);
        if (end.domain->participant) close(*end.domain, end);
        return 0;
    });
}

// Leaves the domain. Functions may still be called for its services, and report that they are closed.
void fast_leave(void *of) {
    guarded<int>(0, [&] {
        auto &domain = *static_cast<Domain *>(of);
        std::lock_guard<std::mutex> last(domain.life);
        if (!domain.participant) return 0;
        for (auto &end : domain.ends) close(domain, *end);
        domain.participant->delete_contained_entities();
        DomainParticipantFactory::get_instance()->delete_participant(domain.participant);
        domain.participant = nullptr;
        return 0;
    });
}
}
