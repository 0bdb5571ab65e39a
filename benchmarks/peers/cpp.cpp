// Measures the C++ that shmgen generates (-t cpp), for latency.py and cpp.py.
//
//   cpp spin|event SIZE RATE SECONDS [1]  prints the age of each sample in ns, then the CPU time in percent of a core.
//                                         With 1, the reader reads each sample in place.
//   cpp publish ROUNDS                    prints the ns per call, one line for each round. cpp.py names the columns.
#include "shm_msgs/bench_msgs/msg/block320.hpp"
#include "shm_msgs/bench_msgs/msg/block56.hpp"
#include "shm_msgs/bench_msgs/msg/mebibyte.hpp"
#include "shm_msgs/geometry_msgs/msg/pose.hpp"

#include <algorithm>
#include <chrono>
#include <cstdio>
#include <cstdlib>
#include <fcntl.h>
#include <memory>
#include <semaphore.h>
#include <string>
#include <sys/mman.h>
#include <sys/resource.h>
#include <sys/wait.h>
#include <time.h>
#include <unistd.h>
#include <vector>

namespace {

// Return the time in ns of the monotonic clock, which all processes share.
std::uint64_t now()
{
    timespec t;
    clock_gettime(CLOCK_MONOTONIC, &t);
    return static_cast<std::uint64_t>(t.tv_sec) * 1000000000u + static_cast<std::uint64_t>(t.tv_nsec);
}

// Send blocks from a child process, and print their ages and the CPU time of this process, the reader.
template <class Block> int measure_stream(bool event, double rate, double seconds, bool in_place)
{
    const std::string topic = "/shmgen_bench_cpp_" + std::to_string(getpid());
    const pid_t sender = fork();
    if (sender == 0) {
        shmgen::Publisher<Block> publisher(topic);
        auto block = std::make_unique<Block>();
        const auto period = static_cast<std::uint64_t>(1e9 / rate);
        std::uint64_t due = now();
        for (int number = 1; number <= seconds * rate; number++) {
            due += period;
            const timespec due_time = {static_cast<time_t>(due / 1000000000), static_cast<long>(due % 1000000000)};
            clock_nanosleep(CLOCK_MONOTONIC, TIMER_ABSTIME, &due_time, nullptr);
            block->data[0] = now();
            (void)publisher.publish(*block);
        }
        _exit(0);
    }
    std::vector<std::uint64_t> ages;
    shmgen::Subscriber<Block> subscriber(topic);
    auto block = std::make_unique<Block>();
    const std::uint64_t start = now();
    std::uint64_t last_arrival = start;
    // End 0.3 s after the last sample. A spinning reader reads the clock only every 65536 polls, because the baseline
    // in floor.c never reads the clock while it polls.
    for (unsigned polls = 1; (!event && polls % 65536 != 0) || now() - last_arrival < 300000000u; polls++) {
        if (event && !subscriber.ready(std::chrono::milliseconds(100)))
            continue;
        if (in_place) {
            auto sample = subscriber.borrow();
            const std::uint64_t sent_at = sample ? sample->data[0] : 0, received_at = now();
            if (sample && sample.give_back()) {
                last_arrival = received_at;
                ages.push_back(received_at - sent_at);
            }
        } else if (subscriber.read_into(*block)) {
            last_arrival = now();
            ages.push_back(last_arrival - block->data[0]);
        }
    }
    rusage usage;
    getrusage(RUSAGE_SELF, &usage);
    const double cpu_seconds = static_cast<double>(usage.ru_utime.tv_sec + usage.ru_stime.tv_sec) +
                               static_cast<double>(usage.ru_utime.tv_usec + usage.ru_stime.tv_usec) / 1e6;
    for (const std::uint64_t age : ages)
        std::printf("%lu\n", static_cast<unsigned long>(age));
    std::printf("%f\n", cpu_seconds / (static_cast<double>(now() - start) / 1e9) * 100);
    waitpid(sender, nullptr, 0);
    for (const char *prefix : {"/dev/shm/", "/dev/shm/sem."})
        for (const char *suffix : {"", "-event"})
            unlink((prefix + topic.substr(1) + suffix).c_str());
    return 0;
}

// Return the mean duration of a call in ns.
template <class Call> double duration_of(int calls, Call call)
{
    const std::uint64_t start = now();
    for (int number = 0; number < calls; number++)
        call();
    return static_cast<double>(now() - start) / calls;
}

// Measure `publish`, and the same work in hand-written code.
int measure_publish(int rounds)
{
    using shm_msgs::bench_msgs::msg::Mebibyte;
    using shm_msgs::geometry_msgs::msg::Pose;
    const std::string topic = "/shmgen_bench_cpp_" + std::to_string(getpid());
    shmgen::Publisher<Pose> publisher(topic);
    shmgen::Options options{};
    options.unstamped = true;
    shmgen::Publisher<Pose> unstamped_publisher(topic + "_bare", options);
    shmgen::Publisher<Mebibyte> large_publisher(topic + "_large");
    auto image = std::make_unique<Mebibyte>();
    Pose pose;
    struct HandWritten {
        sem_t lock;
        unsigned char slots[2][64];
    };
    void *memory = mmap(nullptr, 4 << 20, PROT_READ | PROT_WRITE, MAP_SHARED | MAP_ANONYMOUS, -1, 0);
    auto *hand_written = static_cast<HandWritten *>(memory);
    unsigned char *large_slots = static_cast<unsigned char *>(memory) + 4096;
    sem_init(&hand_written->lock, 1, 1);
    unsigned number = 0; // of the sample; its parity selects the slot
    for (int round = 0; round < rounds; round++) {
        const double by_hand = duration_of(2000, [&] {
            pose.position.x += 1.0;
            sem_wait(&hand_written->lock);
            std::memcpy(hand_written->slots[++number % 2], &pose, sizeof pose);
            __atomic_thread_fence(__ATOMIC_RELEASE);
            sem_post(&hand_written->lock);
        });
        const double by_hand_stamped = duration_of(2000, [&] {
            pose.position.x += 1.0;
            timespec t;
            clock_gettime(CLOCK_REALTIME, &t);
            sem_wait(&hand_written->lock);
            std::memcpy(hand_written->slots[++number % 2], &t, sizeof t);
            std::memcpy(hand_written->slots[number % 2] + 8, &pose, sizeof pose);
            __atomic_thread_fence(__ATOMIC_RELEASE);
            sem_post(&hand_written->lock);
        });
        const double published = duration_of(2000, [&] {
            pose.position.x += 1.0;
            (void)publisher.publish(pose);
        });
        const double try_published = duration_of(2000, [&] {
            pose.position.x += 1.0;
            (void)publisher.try_publish(pose);
        });
        const double unstamped = duration_of(2000, [&] {
            pose.position.x += 1.0;
            (void)unstamped_publisher.publish(pose);
        });
        const double copied = duration_of(4, [&] {
            image->data[0]++;
            std::memcpy(large_slots + (++number % 2 << 20), image.get(), sizeof *image);
        });
        const double published_large = duration_of(4, [&] {
            image->data[0]++;
            (void)large_publisher.publish(*image);
        });
        std::printf("%.1f %.1f %.1f %.1f %.1f %.1f %.1f\n", by_hand, unstamped, by_hand_stamped, published,
                    try_published, copied, published_large);
    }
    for (const char *prefix : {"/dev/shm/", "/dev/shm/sem."})
        for (const char *suffix : {"", "-event", "_bare", "_bare-event", "_large", "_large-event"})
            unlink((prefix + topic.substr(1) + suffix).c_str());
    return 0;
}

} // namespace

int main(int argc, char **argv)
{
    if (argc == 3)
        return measure_publish(std::atoi(argv[2]));
    if (argc != 5 && argc != 6)
        return 2;
    const bool in_place = argc == 6;
    const bool event = std::string(argv[1]) == "event";
    const double rate = std::atof(argv[3]), seconds = std::atof(argv[4]);
    switch (std::atoi(argv[2])) {
    case 56: return measure_stream<shm_msgs::bench_msgs::msg::Block56>(event, rate, seconds, in_place);
    case 320: return measure_stream<shm_msgs::bench_msgs::msg::Block320>(event, rate, seconds, in_place);
    default: return measure_stream<shm_msgs::bench_msgs::msg::Mebibyte>(event, rate, seconds, in_place);
    }
}
