// Fuzzes readers and a writer with a region in which any byte may change. A fuzzer for libFuzzer, or a program that creates
// its own inputs: `hostile INPUTS SEED`. Guard pages surround the region; the sanitizers detect all other wrong accesses.
//
// An input is a list of changes of 6 bytes: a place (2 bytes) and the new value (4 bytes). If PLANTED is set in the
// environment, the program uses a sample in C without checking its counts, and a sanitizer must detect this fault.
#include "shm_hostile/demo_msgs/msg/everything.hpp"
#include "shm_hostile/demo_msgs/msg/everything_shm.h"

#include <cstdio>
#include <cstdlib>
#include <sys/mman.h>

namespace {

using shm_hostile::demo_msgs::msg::Everything;
using shm_hostile::demo_msgs::msg::EverythingPublisher;
using shm_hostile::demo_msgs::msg::EverythingSubscriber;

const char *const TOPIC = std::getenv("TOPIC");
volatile unsigned long checksum;
unsigned long sample_count, refusal_count;

// Moves the mapping of a region between two inaccessible mappings of the same size.
void add_guard_pages(shmgen_link &link)
{
    const std::size_t size = link.size;
    char *reservation = static_cast<char *>(mmap(nullptr, 3 * size, PROT_NONE, MAP_PRIVATE | MAP_ANONYMOUS, -1, 0));
    void *guarded = mremap(link.base, size, size, MREMAP_MAYMOVE | MREMAP_FIXED, reservation + size);
    if (guarded != reservation + size)
        abort();
    link.base = static_cast<unsigned char *>(guarded);
}

template <class Range> void read_bytes(const Range &range)
{
    for (const auto &element : range) {
        unsigned char byte;
        std::memcpy(&byte, &element, 1);
        checksum += byte;
    }
}

void use(const Everything &message)
{
    ++sample_count;
    read_bytes(message.label.view());
    read_bytes(message.wide.view());
    read_bytes(message.text.view());
    read_bytes(message.flags);
    read_bytes(message.samples);
    read_bytes(message.path);
    for (const auto &text : message.words)
        read_bytes(text.view());
    for (const auto &text : message.wides)
        read_bytes(text.str());
    for (std::size_t index = 0; index < 9; ++index)
        checksum += message.samples.find(index) != nullptr;
    checksum += message.flag ? 1 : 2;
}

void use(const shm_demo_msgs_Everything &message)
{
    checksum += std::strlen(message.label) + std::strlen(message.text);
    for (std::uint32_t index = 0; index < message.samples_count; ++index)
        checksum += static_cast<unsigned long>(message.samples[index]);
    for (std::uint32_t index = 0; index < message.words_count; ++index)
        checksum += std::strlen(message.words[index]);
}

struct Endpoints {
    EverythingPublisher publisher{TOPIC, make_options()};
    EverythingSubscriber subscriber{TOPIC, make_options()};
    shm_demo_msgs_Everything_subscriber c_subscriber{};
    std::vector<unsigned char> valid_bytes;

    static shmgen::Options make_options()
    {
        shmgen::Options options;
        options.depth = 4;
        options.lock = std::chrono::microseconds(1);
        return options;
    }
    Endpoints()
    {
        const shmgen_options options = make_options().c();
        if (shm_demo_msgs_Everything_subscriber_open(&c_subscriber, TOPIC, &options) != SHMGEN_OK)
            abort();
        Everything message;
        message.samples = {1, 2, 3};
        message.words = {"a", "b"};
        for (int number = 0; number < 11; ++number)
            if (publisher.publish(message) != SHMGEN_OK)
                abort();
        add_guard_pages(publisher.c().end);
        add_guard_pages(subscriber.c().end);
        add_guard_pages(c_subscriber.end.end);
        const unsigned char *base = publisher.c().end.base;
        valid_bytes.assign(base, base + publisher.c().end.size);
    }
};

void read_everything(Endpoints &endpoints)
{
    if (const auto sample = endpoints.subscriber.read_next())
        use(*sample);
    if (const auto sample = endpoints.subscriber.try_read())
        use(*sample);
    refusal_count += endpoints.subscriber.status() == SHMGEN_COUNT_EXCEEDED;
    endpoints.subscriber.read_all([](const Everything &message) { use(message); });
    (void)endpoints.subscriber.is_stale(std::chrono::seconds(1));
    (void)endpoints.subscriber.ready(std::chrono::nanoseconds(0));
    static shm_demo_msgs_Everything message;
    if (shm_demo_msgs_Everything_subscriber_read_next(&endpoints.c_subscriber, &message) == SHMGEN_OK)
        use(message);
}

} // namespace

extern "C" int LLVMFuzzerTestOneInput(const std::uint8_t *data, std::size_t size)
{
    static Endpoints endpoints;
    static unsigned long inputs;
    unsigned char *base = endpoints.publisher.c().end.base;
    std::memcpy(base, endpoints.valid_bytes.data(), endpoints.valid_bytes.size());
    const std::uint32_t pid = endpoints.publisher.c().end.pid;
    for (std::size_t at = 0; at + 6 <= size && at < 240; at += 6) {
        std::uint16_t place;
        std::memcpy(&place, data + at, sizeof place);
        // Half of the changes hit the header, although the header is a small part of the region.
        const std::size_t offset = (place & 1) != 0 ? (place >> 1) % 188 : (place >> 1) % (endpoints.valid_bytes.size() - 4);
        std::memcpy(base + offset, data + at + 2, 4);
    }
    endpoints.subscriber.c().last = endpoints.c_subscriber.end.last = size > 0 ? data[size - 1] % 12u : 0;
    if (std::getenv("PLANTED") != nullptr) {
        shm_demo_msgs_Everything message;
        const std::size_t slot = shmgen_slot_of(&endpoints.c_subscriber.end.end, 11, 0);
        std::memcpy(&message, base + slot + SHMGEN_SLOT_HEADER, sizeof message);
        use(message);
        return 0;
    }
    shmgen_store(&endpoints.publisher.c().end, SHMGEN_AT(retired), 0); // a reader would reopen a retired region, without guard pages
    read_everything(endpoints);
    if (endpoints.publisher.is_open()) {
        const std::uint32_t sequence = endpoints.publisher.c().sequence;
        std::memcpy(&endpoints.publisher.c().sequence, base + SHMGEN_AT(completed0), sizeof sequence);
        shmgen_store(&endpoints.publisher.c().end, SHMGEN_AT(writer), pid); // otherwise the publisher would lose its claim for good
        shmgen_store(&endpoints.publisher.c().end, SHMGEN_AT(turn), endpoints.publisher.c().turn);
        (void)!endpoints.publisher.try_publish(Everything());
        endpoints.publisher.c().sequence = sequence;
        read_everything(endpoints);
    }
    if (++inputs % 64 == 0) { // also open the changed region; only in some runs, because creating a header takes 2 ms
        if (shmgen_load(&endpoints.publisher.c().end, SHMGEN_AT(magic)) != 0) {
            EverythingSubscriber new_subscriber;
            if (new_subscriber.open(TOPIC, Endpoints::make_options()) == SHMGEN_OK)
                if (const auto sample = new_subscriber.read())
                    use(*sample);
        }
    }
    return 0;
}

#ifndef LIBFUZZER
int main(int argc, char **argv)
{
    const unsigned long inputs = argc > 1 ? std::strtoul(argv[1], nullptr, 10) : 1000;
    std::uint64_t state = argc > 2 ? std::strtoul(argv[2], nullptr, 10) : 1;
    const auto next_random = [&state] {
        state ^= state << 13;
        state ^= state >> 7;
        state ^= state << 17;
        return static_cast<std::uint32_t>(state >> 16);
    };
    for (unsigned long input = 0; input < inputs; ++input) {
        std::uint8_t data[241];
        const std::size_t changes = 1 + next_random() % 40;
        for (std::size_t at = 0; at < changes * 6; at += 6) {
            const std::uint32_t place = next_random();
            // Small numbers, large numbers, powers of two, and any number.
            const std::uint32_t values[] = {next_random() % 16, 4294967295u - next_random() % 16, 1u << next_random() % 32, next_random()};
            const std::uint32_t value = values[next_random() % 4];
            std::memcpy(data + at, &place, 2);
            std::memcpy(data + at + 2, &value, 4);
        }
        data[changes * 6] = static_cast<std::uint8_t>(next_random());
        LLVMFuzzerTestOneInput(data, changes * 6 + 1);
    }
    std::printf("%lu inputs, %lu samples read, %lu refused\n", inputs, sample_count, refusal_count);
}
#endif
