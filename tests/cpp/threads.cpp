// A writer thread and a reader thread. Both use one mapping of the region, so that the thread sanitizer detects data races.
// It must report none for `threads`, but a race for `threads unlocked`: without a lock, only the slot numbers detect overwriting.
#include <cerrno>
#include <ctime>
#include <sched.h>
#include <semaphore.h>

// The thread sanitizer of gcc 12 supports sem_trywait, but not sem_clockwait.
static int clockwait_by_polling(sem_t *semaphore, clockid_t clock, const timespec *until)
{
    while (sem_trywait(semaphore) != 0) {
        timespec now{};
        clock_gettime(clock, &now);
        if (now.tv_sec > until->tv_sec || (now.tv_sec == until->tv_sec && now.tv_nsec >= until->tv_nsec)) {
            errno = ETIMEDOUT;
            return -1;
        }
        sched_yield();
    }
    return 0;
}
#define sem_clockwait clockwait_by_polling
#include "shm_plc_demo/demo_msgs/msg/demo.hpp"

#include <atomic>
#include <cstdio>
#include <thread>

using namespace std::chrono_literals;
using shm_plc_demo::demo_msgs::msg::Demo;

int main(int count, char **)
{
    constexpr std::uint32_t SAMPLES = 100000;
    shmgen::Options options{};
    options.depth = 4;
    options.lock = std::chrono::seconds(1);
    shm_plc_demo::demo_msgs::msg::DemoPublisher publisher("/shmgen_test/threads", options);
    shm_plc_demo::demo_msgs::msg::DemoSubscriber subscriber("/shmgen_test/threads", options);
    shmgen_link &link = subscriber.c().end;
    munmap(link.base, static_cast<std::size_t>(link.size));
    unsigned char *const subscriber_base = link.base;
    link.base = publisher.c().end.base;
    const bool is_unlocked = count > 1;
    if (is_unlocked) // without the event also, because a semaphore orders memory accesses
        publisher.c().end.lock = link.lock = publisher.c().end.event = nullptr;
    unsigned long failures = 0, read = 0, failed_publishes = 0;
    std::atomic<bool> is_running{false};
    std::thread reader([&] {
        is_running = true;
        std::uint32_t previous = 0;
        while (previous < SAMPLES) {
            const auto sample = !is_unlocked && read % 2 != 0 ? subscriber.wait(20s) : subscriber.read_next();
            if (!sample)
                continue;
            failures += sample->a <= previous || sample->b != 2 * sample->a;
            previous = sample->a;
            ++read;
        }
    });
    while (!is_running)
        std::this_thread::yield();
    Demo message;
    for (std::uint32_t a = 1; a <= SAMPLES; ++a) {
        message.a = a;
        message.b = 2 * a;
        failed_publishes += publisher.publish(message) != SHMGEN_OK;
    }
    reader.join();
    failures += failed_publishes;
    std::printf("%lu wrong; read and missed: %lu\n", failures, read + subscriber.missed());
    void *const mapping = mmap(subscriber_base, static_cast<std::size_t>(link.size), PROT_READ, MAP_PRIVATE | MAP_ANONYMOUS, -1, 0);
    link.base = static_cast<unsigned char *>(mapping);
    return failures != 0;
}
