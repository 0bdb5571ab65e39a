// A writer or a reader in C++ for tests/rigs/chaos.py, which kills and stops this process at random times.
//
//   chaos write|read|next|wait Small|Large TOPIC DEPTH INDEX COUNTERS ERRORS PATTERNS SEED
//
// COUNTERS is the descriptor of a file with one u64 for each role. This process increments number INDEX with each sample.
// Errors are written to the descriptor ERRORS. PATTERNS is a file: 61 checksums of 4 bytes, then the data of 61 samples.
#include <cstddef>

// Simulate a machine on which the lock is mandatory, and slow memory: samples are copied in two halves. Readers begin with
// the back half and writers with the front half, so that a read often overlaps a write.
extern bool keeps_order;
void copy_slowly(void *to, const void *from, std::size_t size);
#define SHMGEN_KEEPS_ORDER keeps_order
#define SHMGEN_COPY copy_slowly

#include "shm_chaos/chaos_msgs/msg/large.hpp"
#include "shm_chaos/chaos_msgs/msg/small.hpp"

#include <cstdio>
#include <memory>
#include <random>

bool keeps_order = true;

namespace {

using namespace std::chrono_literals;

bool is_slow = false, is_writer = false;
std::mt19937 rng;
int error_file;
volatile std::uint64_t *counter;
const std::uint32_t *checksums;
const unsigned char *patterns;

double random_fraction() { return std::uniform_real_distribution<double>(0, 1)(rng); }

[[noreturn]] void report_and_exit(const std::string &text)
{
    const std::string line = text + "\n";
    (void)!write(error_file, line.data(), line.size());
    _exit(0);
}

template <class T> void check(const T &message, std::uint32_t sequence)
{
    const unsigned index = static_cast<unsigned>(message.number % 61);
    const auto expected = checksums[index] ^ static_cast<std::uint32_t>(message.number);
    if (message.checksum != expected || std::memcmp(message.data.data(), patterns + index * message.data.size(), message.data.size()) != 0)
        report_and_exit("C++ reader: torn: sample " + std::to_string(sequence) + " contains " + std::to_string(message.number));
    if (message.number != sequence)
        report_and_exit("C++ reader: sample " + std::to_string(sequence) + " contains " + std::to_string(message.number));
}

template <class T> void publish_until_killed(const char *topic, const shmgen::Options &options)
{
    shmgen::Publisher<T> publisher;
    const shmgen::Status open_status = publisher.open(topic, options);
    if (open_status != SHMGEN_OK)
        report_and_exit(std::string("C++ writer: ") + shmgen::text_of(open_status));
    const auto message = std::make_unique<T>();
    const std::int64_t pause = random_fraction() < 0.5 ? 0 : 300000;
    for (;;) {
        message->number = publisher.sequence() + 1;
        const unsigned index = static_cast<unsigned>(message->number % 61);
        message->checksum = checksums[index] ^ static_cast<std::uint32_t>(message->number);
        std::memcpy(message->data.data(), patterns + index * message->data.size(), message->data.size());
        const shmgen::Status status = publisher.publish(*message);
        if (status == SHMGEN_LOCK_TIMEOUT)
            continue;
        if (status != SHMGEN_OK)
            report_and_exit(std::string("C++ writer: ") + shmgen::text_of(status));
        *counter = *counter + 1;
        shmgen_pause(pause);
    }
}

template <class T> void read_until_killed(const std::string &mode, const char *topic, const shmgen::Options &options)
{
    shmgen::Subscriber<T> subscriber;
    const shmgen::Status open_status = subscriber.open(topic, options);
    if (open_status != SHMGEN_OK)
        report_and_exit(std::string("C++ reader: ") + shmgen::text_of(open_status));
    const std::uint32_t start = subscriber.c().last;
    std::uint32_t last_sequence = start, count = 0;
    const auto message = std::make_unique<T>();
    for (;;) {
        shmgen::Status status;
        if (mode == "wait")
            status = subscriber.ready(50ms) ? subscriber.read_into(*message) : SHMGEN_NOTHING_NEW;
        else
            status = mode == "next" ? subscriber.next_into(*message) : subscriber.read_into(*message);
        if (status != SHMGEN_OK) {
            if (status != SHMGEN_NOTHING_NEW && status != SHMGEN_LOCK_TIMEOUT && status != SHMGEN_OVERWRITTEN)
                report_and_exit(std::string("C++ reader: ") + shmgen::text_of(status));
            continue;
        }
        check(*message, subscriber.sequence());
        if (subscriber.sequence() <= last_sequence)
            report_and_exit("C++ reader: " + std::to_string(subscriber.sequence()) + " after " + std::to_string(last_sequence));
        last_sequence = subscriber.sequence();
        ++count;
        if (start + count + subscriber.missed() != last_sequence)
            report_and_exit("C++ reader: from " + std::to_string(start) + " to " + std::to_string(last_sequence) + ", " +
                            std::to_string(count) + " read and " + std::to_string(subscriber.missed()) + " missed do not add up");
        *counter = *counter + 1;
    }
}

void *map_file(int file, std::size_t size, int protection)
{
    void *memory = mmap(nullptr, size, protection, MAP_SHARED, file, 0);
    if (memory == MAP_FAILED)
        report_and_exit("C++: mmap failed");
    return memory;
}

} // namespace

void copy_slowly(void *to, const void *from, std::size_t size)
{
    const std::size_t half = is_slow ? size / 2 : 0;
    const auto pause = [] {
        if (is_slow && random_fraction() < 0.3)
            shmgen_pause(static_cast<std::int64_t>(random_fraction() * 500000));
    };
    char *target = static_cast<char *>(to);
    const char *source = static_cast<const char *>(from);
    if (is_writer) {
        std::memcpy(target, source, half);
        pause();
        std::memcpy(target + half, source + half, size - half);
    } else {
        std::memcpy(target + half, source + half, size - half);
        pause();
        std::memcpy(target, source, half);
    }
}

int main(int, char **argv)
{
    const std::string mode = argv[1];
    const bool large = std::string(argv[2]) == "Large";
    error_file = std::stoi(argv[7]);
    counter = static_cast<volatile std::uint64_t *>(map_file(std::stoi(argv[6]), 4096, PROT_READ | PROT_WRITE)) + std::stoi(argv[5]);
    const std::size_t size = large ? sizeof(shm_chaos::chaos_msgs::msg::Large::data) : sizeof(shm_chaos::chaos_msgs::msg::Small::data);
    void *file = map_file(open(argv[8], O_RDONLY), 61 * (4 + size), PROT_READ);
    checksums = static_cast<const std::uint32_t *>(file);
    patterns = static_cast<const unsigned char *>(file) + 61 * 4;
    rng.seed(static_cast<std::mt19937::result_type>(std::stoul(argv[9])));
    keeps_order = random_fraction() < 0.7;
    is_slow = !large && random_fraction() < 0.5;
    is_writer = mode == "write";
    shmgen::Options options{};
    options.depth = static_cast<std::uint32_t>(std::stoul(argv[4]));
    const std::uint32_t lock_timeouts[] = {1, 1, 1000, 10000};
    options.lock = std::chrono::microseconds(lock_timeouts[rng() % 4]);
    using shm_chaos::chaos_msgs::msg::Large;
    using shm_chaos::chaos_msgs::msg::Small;
    if (is_writer)
        large ? publish_until_killed<Large>(argv[3], options) : publish_until_killed<Small>(argv[3], options);
    else
        large ? read_until_killed<Large>(mode, argv[3], options) : read_until_killed<Small>(mode, argv[3], options);
}
