// A region whose every byte may be anything, before and while it is open: what a reader does with it. For libFuzzer, or by
// itself: `hostile INPUTS SEED`. The region lies between pages that nobody may touch, and the sanitizers see the rest.
//
// An input is a list of changes, six bytes each: where (two bytes), and what to put there (four). PLANTED=1 in the
// environment lets the C reader believe a count, which must be found.
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
volatile unsigned long seen;
unsigned long whole, refused;

// Moves a mapping between two of the same size that nobody may touch.
void fence(shmgen_link &end)
{
    const std::size_t size = end.size;
    char *room = static_cast<char *>(mmap(nullptr, 3 * size, PROT_NONE, MAP_PRIVATE | MAP_ANONYMOUS, -1, 0));
    void *moved = mremap(end.base, size, size, MREMAP_MAYMOVE | MREMAP_FIXED, room + size);
    if (moved != room + size)
        abort();
    end.base = static_cast<unsigned char *>(moved);
}

template <class Range> void touch(const Range &range)
{
    for (const auto &element : range) {
        unsigned char byte;
        std::memcpy(&byte, &element, 1);
        seen += byte;
    }
}

void use(const Everything &message)
{
    ++whole;
    touch(message.label.view());
    touch(message.wide.view());
    touch(message.text.view());
    touch(message.flags);
    touch(message.samples);
    touch(message.path);
    for (const auto &word : message.words)
        touch(word.view());
    for (const auto &word : message.wides)
        touch(word.str());
    for (std::size_t index = 0; index < 9; ++index)
        seen += message.samples.find(index) != nullptr;
    seen += message.flag ? 1 : 2;
}

void use(const shm_demo_msgs_Everything &message)
{
    seen += std::strlen(message.label) + std::strlen(message.text);
    for (std::uint32_t index = 0; index < message.samples_count; ++index)
        seen += static_cast<unsigned long>(message.samples[index]);
    for (std::uint32_t index = 0; index < message.words_count; ++index)
        seen += std::strlen(message.words[index]);
}

struct Stage {
    EverythingPublisher publisher{TOPIC, options()};
    EverythingSubscriber subscriber{TOPIC, options()};
    shm_demo_msgs_Everything_subscriber in_c{};
    std::vector<unsigned char> fresh;

    static shmgen::Options options()
    {
        shmgen::Options made;
        made.depth = 4;
        made.lock = std::chrono::microseconds(1);
        return made;
    }
    Stage()
    {
        const shmgen_options made = options().c();
        if (shm_demo_msgs_Everything_subscriber_open(&in_c, TOPIC, &made) != SHMGEN_OK)
            abort();
        Everything message;
        message.samples = {1, 2, 3};
        message.words = {"a", "b"};
        for (int number = 0; number < 11; ++number)
            if (publisher.publish(message) != SHMGEN_OK)
                abort();
        fence(publisher.c().end);
        fence(subscriber.c().end);
        fence(in_c.end.end);
        const unsigned char *base = publisher.c().end.base;
        fresh.assign(base, base + publisher.c().end.size);
    }
};

void read_all(Stage &stage)
{
    if (const auto found = stage.subscriber.read_next())
        use(*found);
    if (const auto found = stage.subscriber.try_read())
        use(*found);
    refused += stage.subscriber.status() == SHMGEN_COUNT_EXCEEDED;
    stage.subscriber.read_all([](const Everything &message) { use(message); });
    (void)stage.subscriber.is_stale(std::chrono::seconds(1));
    (void)stage.subscriber.ready(std::chrono::nanoseconds(0));
    static shm_demo_msgs_Everything copy;
    if (shm_demo_msgs_Everything_subscriber_read_next(&stage.in_c, &copy) == SHMGEN_OK)
        use(copy);
}

} // namespace

extern "C" int LLVMFuzzerTestOneInput(const std::uint8_t *data, std::size_t size)
{
    static Stage stage;
    static unsigned long inputs;
    unsigned char *base = stage.publisher.c().end.base;
    std::memcpy(base, stage.fresh.data(), stage.fresh.size());
    const std::uint32_t pid = stage.publisher.c().end.pid;
    for (std::size_t at = 0; at + 6 <= size && at < 240; at += 6) {
        std::uint16_t where;
        std::memcpy(&where, data + at, sizeof where);
        // Half of the changes hit the header, which is a small part of all.
        const std::size_t offset = (where & 1) != 0 ? (where >> 1) % 188 : (where >> 1) % (stage.fresh.size() - 4);
        std::memcpy(base + offset, data + at + 2, 4);
    }
    stage.subscriber.c().last = stage.in_c.end.last = size > 0 ? data[size - 1] % 12u : 0;
    if (std::getenv("PLANTED") != nullptr) {
        shm_demo_msgs_Everything copy;
        const std::size_t slot = shmgen_slot_of(&stage.in_c.end.end, 11, 0);
        std::memcpy(&copy, base + slot + SHMGEN_SLOT_HEADER, sizeof copy);
        use(copy);
        return 0;
    }
    shmgen_store(&stage.publisher.c().end, SHMGEN_AT(retired), 0); // a retired region would be reopened, without the fences
    read_all(stage);
    if (stage.publisher.is_open()) {
        const std::uint32_t sequence = stage.publisher.c().sequence;
        std::memcpy(&stage.publisher.c().sequence, base + SHMGEN_AT(completed0), sizeof sequence);
        shmgen_store(&stage.publisher.c().end, SHMGEN_AT(writer), pid); // else it would be lost, for good
        shmgen_store(&stage.publisher.c().end, SHMGEN_AT(turn), stage.publisher.c().turn);
        (void)!stage.publisher.try_publish(Everything());
        stage.publisher.c().sequence = sequence;
        read_all(stage);
    }
    if (++inputs % 64 == 0) { // and by one that opens it as it is now; making a header takes 2 ms
        if (shmgen_load(&stage.publisher.c().end, SHMGEN_AT(magic)) != 0) {
            EverythingSubscriber late;
            if (late.open(TOPIC, Stage::options()) == SHMGEN_OK)
                if (const auto found = late.read())
                    use(*found);
        }
    }
    return 0;
}

#ifndef LIBFUZZER
int main(int count, char **words)
{
    const unsigned long inputs = count > 1 ? std::strtoul(words[1], nullptr, 10) : 1000;
    std::uint64_t state = count > 2 ? std::strtoul(words[2], nullptr, 10) : 1;
    const auto random = [&state] {
        state ^= state << 13;
        state ^= state >> 7;
        state ^= state << 17;
        return static_cast<std::uint32_t>(state >> 16);
    };
    for (unsigned long input = 0; input < inputs; ++input) {
        std::uint8_t data[241];
        const std::size_t changes = 1 + random() % 40;
        for (std::size_t at = 0; at < changes * 6; at += 6) {
            const std::uint32_t where = random();
            // Small numbers, numbers beside those that are there, the ends of what fits, anything.
            const std::uint32_t values[] = {random() % 16, 4294967295u - random() % 16, 1u << random() % 32, random()};
            const std::uint32_t value = values[random() % 4];
            std::memcpy(data + at, &where, 2);
            std::memcpy(data + at + 2, &value, 4);
        }
        data[changes * 6] = static_cast<std::uint8_t>(random());
        LLVMFuzzerTestOneInput(data, changes * 6 + 1);
    }
    std::printf("%lu inputs, %lu samples taken, %lu refused\n", inputs, whole, refused);
}
#endif
