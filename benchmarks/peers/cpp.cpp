// Measures the C++ that shmgen generates (-t cpp), for latency.py and cpp.py.
//
//   cpp spin|event SIZE RATE SECONDS [1]  prints the age of each sample in ns, then the CPU in percent of a core;
//                                         1: read in place
//   cpp publish ROUNDS                    prints ns per call, one line for each round: see cpp.py
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

std::uint64_t now()
{
    timespec t;
    clock_gettime(CLOCK_MONOTONIC, &t);
    return static_cast<std::uint64_t>(t.tv_sec) * 1000000000u + static_cast<std::uint64_t>(t.tv_nsec);
}

template <class Block> int one_way(bool event, double rate, double seconds, bool in_place)
{
    const std::string topic = "/shmgen_bench_cpp_" + std::to_string(getpid());
    const pid_t sender = fork();
    if (sender == 0) {
        shmgen::Publisher<Block> publisher(topic);
        auto own = std::make_unique<Block>();
        const auto period = static_cast<std::uint64_t>(1e9 / rate);
        std::uint64_t due = now();
        for (int number = 1; number <= seconds * rate; number++) {
            due += period;
            const timespec until = {static_cast<time_t>(due / 1000000000), static_cast<long>(due % 1000000000)};
            clock_nanosleep(CLOCK_MONOTONIC, TIMER_ABSTIME, &until, nullptr);
            own->data[0] = now();
            (void)publisher.publish(*own);
        }
        _exit(0);
    }
    std::vector<std::uint64_t> ages;
    shmgen::Subscriber<Block> subscriber(topic);
    auto own = std::make_unique<Block>();
    const std::uint64_t began = now();
    std::uint64_t last = began;
    // A spinning reader reads the clock only every 65536 polls, because the baseline never reads the clock.
    for (unsigned looks = 1; (!event && looks % 65536 != 0) || now() - last < 300000000u; looks++) {
        if (event && !subscriber.ready(std::chrono::milliseconds(100)))
            continue;
        if (in_place) {
            auto sample = subscriber.borrow();
            const std::uint64_t sent = sample ? sample->data[0] : 0, held = now();
            if (sample && sample.give_back()) {
                last = held;
                ages.push_back(held - sent);
            }
        } else if (subscriber.read_into(*own)) {
            last = now();
            ages.push_back(last - own->data[0]);
        }
    }
    rusage used;
    getrusage(RUSAGE_SELF, &used);
    const double busy = static_cast<double>(used.ru_utime.tv_sec + used.ru_stime.tv_sec) +
                        static_cast<double>(used.ru_utime.tv_usec + used.ru_stime.tv_usec) / 1e6;
    for (const std::uint64_t age : ages)
        std::printf("%lu\n", static_cast<unsigned long>(age));
    std::printf("%f\n", busy / (static_cast<double>(now() - began) / 1e9) * 100);
    waitpid(sender, nullptr, 0);
    for (const char *prefix : {"/dev/shm/", "/dev/shm/sem."})
        for (const char *end : {"", "-event"})
            unlink((prefix + topic.substr(1) + end).c_str());
    return 0;
}

template <class Call> double timed(int calls, Call call)
{
    const std::uint64_t start = now();
    for (int number = 0; number < calls; number++)
        call();
    return static_cast<double>(now() - start) / calls;
}

int publish(int rounds)
{
    using shm_msgs::bench_msgs::msg::Mebibyte;
    using shm_msgs::geometry_msgs::msg::Pose;
    const std::string topic = "/shmgen_bench_cpp_" + std::to_string(getpid());
    shmgen::Publisher<Pose> publisher(topic);
    shmgen::Options options{};
    options.unstamped = true;
    shmgen::Publisher<Pose> bare(topic + "_bare", options);
    shmgen::Publisher<Mebibyte> large(topic + "_large");
    auto image = std::make_unique<Mebibyte>();
    Pose pose;
    struct Hand {
        sem_t lock;
        unsigned char slots[2][64];
    };
    void *room = mmap(nullptr, 4 << 20, PROT_READ | PROT_WRITE, MAP_SHARED | MAP_ANONYMOUS, -1, 0);
    auto *hand = static_cast<Hand *>(room);
    unsigned char *far = static_cast<unsigned char *>(room) + 4096;
    sem_init(&hand->lock, 1, 1);
    unsigned turn = 0;
    for (int round = 0; round < rounds; round++) {
        const double by_hand = timed(2000, [&] {
            pose.position.x += 1.0;
            sem_wait(&hand->lock);
            std::memcpy(hand->slots[++turn % 2], &pose, sizeof pose);
            __atomic_thread_fence(__ATOMIC_RELEASE);
            sem_post(&hand->lock);
        });
        const double stamped = timed(2000, [&] {
            pose.position.x += 1.0;
            timespec t;
            clock_gettime(CLOCK_REALTIME, &t);
            sem_wait(&hand->lock);
            std::memcpy(hand->slots[++turn % 2], &t, sizeof t);
            std::memcpy(hand->slots[turn % 2] + 8, &pose, sizeof pose);
            __atomic_thread_fence(__ATOMIC_RELEASE);
            sem_post(&hand->lock);
        });
        const double ours = timed(2000, [&] {
            pose.position.x += 1.0;
            (void)publisher.publish(pose);
        });
        const double tried = timed(2000, [&] {
            pose.position.x += 1.0;
            (void)publisher.try_publish(pose);
        });
        const double unstamped = timed(2000, [&] {
            pose.position.x += 1.0;
            (void)bare.publish(pose);
        });
        const double copied = timed(4, [&] {
            image->data[0]++;
            std::memcpy(far + (++turn % 2 << 20), image.get(), sizeof *image);
        });
        const double sent = timed(4, [&] {
            image->data[0]++;
            (void)large.publish(*image);
        });
        std::printf("%.1f %.1f %.1f %.1f %.1f %.1f %.1f\n", by_hand, unstamped, stamped, ours, tried, copied, sent);
    }
    for (const char *prefix : {"/dev/shm/", "/dev/shm/sem."})
        for (const char *end : {"", "-event", "_bare", "_bare-event", "_large", "_large-event"})
            unlink((prefix + topic.substr(1) + end).c_str());
    return 0;
}

} // namespace

int main(int count, char **words)
{
    if (count == 3)
        return publish(std::atoi(words[2]));
    if (count != 5 && count != 6)
        return 2;
    const bool in_place = count == 6;
    const bool event = std::string(words[1]) == "event";
    const double rate = std::atof(words[3]), seconds = std::atof(words[4]);
    switch (std::atoi(words[2])) {
    case 56: return one_way<shm_msgs::bench_msgs::msg::Block56>(event, rate, seconds, in_place);
    case 320: return one_way<shm_msgs::bench_msgs::msg::Block320>(event, rate, seconds, in_place);
    default: return one_way<shm_msgs::bench_msgs::msg::Mebibyte>(event, rate, seconds, in_place);
    }
}
