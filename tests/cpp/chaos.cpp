// A writer or a reader of tests/rigs/chaos.py in C++, which is killed and stopped at random instants.
//
//   chaos write|read|next|wait Small|Large TOPIC DEPTH PLACE MOVES COMPLAINTS PATTERNS SEED
//
// MOVES and COMPLAINTS are descriptors: one u64 a place, counted up with each sample, and where lines are written to.
// PATTERNS is a file: 61 checksums of four bytes, then 61 times the bytes of a sample.
#include <cstddef>

// As on a machine where the lock is needed, or where memory is slow: samples are copied in two halves, read from the back
// and written from the front, so that the two meet.
extern bool keeps_order;
void copied_slowly(void *to, const void *from, std::size_t size);
#define SHMGEN_KEEPS_ORDER keeps_order
#define SHMGEN_COPY copied_slowly

#include "shm_chaos/chaos_msgs/msg/large.hpp"
#include "shm_chaos/chaos_msgs/msg/small.hpp"

#include <cstdio>
#include <memory>
#include <random>

bool keeps_order = true;

namespace {

using namespace std::chrono_literals;

bool slow = false, writes = false;
std::mt19937 rng;
int complaints;
volatile std::uint64_t *moves;
const std::uint32_t *checksums;
const unsigned char *patterns;

double chance() { return std::uniform_real_distribution<double>(0, 1)(rng); }

[[noreturn]] void complain(const std::string &text)
{
    const std::string line = text + "\n";
    (void)!write(complaints, line.data(), line.size());
    _exit(0);
}

template <class T> void check(const T &message, std::uint32_t sequence)
{
    const unsigned place = static_cast<unsigned>(message.number % 61);
    const auto wanted = checksums[place] ^ static_cast<std::uint32_t>(message.number);
    if (message.checksum != wanted || std::memcmp(message.data.data(), patterns + place * message.data.size(), message.data.size()) != 0)
        complain("C++ reader: torn: sample " + std::to_string(sequence) + " says " + std::to_string(message.number));
    if (message.number != sequence)
        complain("C++ reader: sample " + std::to_string(sequence) + " says " + std::to_string(message.number));
}

template <class T> void write_on(const char *topic, const shmgen::Options &options)
{
    shmgen::Publisher<T> publisher;
    const shmgen::Status opened = publisher.open(topic, options);
    if (opened != SHMGEN_OK)
        complain(std::string("C++ writer: ") + shmgen::text_of(opened));
    const auto message = std::make_unique<T>();
    const std::int64_t pause = chance() < 0.5 ? 0 : 300000;
    for (;;) {
        message->number = publisher.sequence() + 1;
        const unsigned place = static_cast<unsigned>(message->number % 61);
        message->checksum = checksums[place] ^ static_cast<std::uint32_t>(message->number);
        std::memcpy(message->data.data(), patterns + place * message->data.size(), message->data.size());
        const shmgen::Status status = publisher.publish(*message);
        if (status == SHMGEN_LOCK_TIMEOUT)
            continue;
        if (status != SHMGEN_OK)
            complain(std::string("C++ writer: ") + shmgen::text_of(status));
        *moves = *moves + 1;
        shmgen_pause(pause);
    }
}

template <class T> void read_on(const std::string &way, const char *topic, const shmgen::Options &options)
{
    shmgen::Subscriber<T> subscriber;
    const shmgen::Status opened = subscriber.open(topic, options);
    if (opened != SHMGEN_OK)
        complain(std::string("C++ reader: ") + shmgen::text_of(opened));
    const std::uint32_t start = subscriber.c().last;
    std::uint32_t last = start, count = 0;
    const auto message = std::make_unique<T>();
    for (;;) {
        shmgen::Status status;
        if (way == "wait")
            status = subscriber.ready(50ms) ? subscriber.read_into(*message) : SHMGEN_NOTHING_NEW;
        else
            status = way == "next" ? subscriber.next_into(*message) : subscriber.read_into(*message);
        if (status != SHMGEN_OK) {
            if (status != SHMGEN_NOTHING_NEW && status != SHMGEN_LOCK_TIMEOUT && status != SHMGEN_OVERWRITTEN)
                complain(std::string("C++ reader: ") + shmgen::text_of(status));
            continue;
        }
        check(*message, subscriber.sequence());
        if (subscriber.sequence() <= last)
            complain("C++ reader: " + std::to_string(subscriber.sequence()) + " after " + std::to_string(last));
        last = subscriber.sequence();
        ++count;
        if (start + count + subscriber.missed() != last)
            complain("C++ reader: from " + std::to_string(start) + " to " + std::to_string(last) + " are not " +
                     std::to_string(count) + " read and " + std::to_string(subscriber.missed()) + " missed");
        *moves = *moves + 1;
    }
}

void *mapped(int file, std::size_t size, int protection)
{
    void *found = mmap(nullptr, size, protection, MAP_SHARED, file, 0);
    if (found == MAP_FAILED)
        complain("C++: cannot map");
    return found;
}

} // namespace

void copied_slowly(void *to, const void *from, std::size_t size)
{
    const std::size_t half = slow ? size / 2 : 0;
    const auto pause = [] {
        if (slow && chance() < 0.3)
            shmgen_pause(static_cast<std::int64_t>(chance() * 500000));
    };
    char *into = static_cast<char *>(to);
    const char *out = static_cast<const char *>(from);
    if (writes) {
        std::memcpy(into, out, half);
        pause();
        std::memcpy(into + half, out + half, size - half);
    } else {
        std::memcpy(into + half, out + half, size - half);
        pause();
        std::memcpy(into, out, half);
    }
}

int main(int, char **words)
{
    const std::string way = words[1];
    const bool large = std::string(words[2]) == "Large";
    complaints = std::stoi(words[7]);
    moves = static_cast<volatile std::uint64_t *>(mapped(std::stoi(words[6]), 4096, PROT_READ | PROT_WRITE)) + std::stoi(words[5]);
    const std::size_t size = large ? sizeof(shm_chaos::chaos_msgs::msg::Large::data) : sizeof(shm_chaos::chaos_msgs::msg::Small::data);
    void *file = mapped(open(words[8], O_RDONLY), 61 * (4 + size), PROT_READ);
    checksums = static_cast<const std::uint32_t *>(file);
    patterns = static_cast<const unsigned char *>(file) + 61 * 4;
    rng.seed(static_cast<std::mt19937::result_type>(std::stoul(words[9])));
    keeps_order = chance() < 0.7;
    slow = !large && chance() < 0.5;
    writes = way == "write";
    shmgen::Options options{};
    options.depth = static_cast<std::uint32_t>(std::stoul(words[4]));
    const std::uint32_t limits[] = {1, 1, 1000, 10000};
    options.lock = std::chrono::microseconds(limits[rng() % 4]);
    using shm_chaos::chaos_msgs::msg::Large;
    using shm_chaos::chaos_msgs::msg::Small;
    if (writes)
        large ? write_on<Large>(words[3], options) : write_on<Small>(words[3], options);
    else
        large ? read_on<Large>(way, words[3], options) : read_on<Small>(way, words[3], options);
}
