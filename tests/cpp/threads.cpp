// Two threads, each with an end of its own, whose regions are mapped at one place, so that the thread sanitizer sees what
// both do. `threads` must be clean; `threads unlocked`, where the slots alone carry integrity, is what it must find.
#include <cerrno>
#include <ctime>
#include <sched.h>
#include <semaphore.h>

// gcc 12's sanitizer sees that sem_trywait takes a token, not that sem_clockwait does.
static int seen_clockwait(sem_t *semaphore, clockid_t clock, const timespec *until)
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
#define sem_clockwait seen_clockwait
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
    shmgen_link &end = subscriber.c().end;
    munmap(end.base, static_cast<std::size_t>(end.size));
    unsigned char *const own = end.base;
    end.base = publisher.c().end.base;
    const bool unlocked = count > 1;
    if (unlocked) // and without the event, which orders as well
        publisher.c().end.lock = end.lock = publisher.c().end.event = nullptr;
    unsigned long wrong = 0, read = 0, unsent = 0;
    std::atomic<bool> runs{false};
    std::thread reader([&] {
        runs = true;
        std::uint32_t last = 0;
        while (last < SAMPLES) {
            const auto sample = !unlocked && read % 2 != 0 ? subscriber.wait(20s) : subscriber.read_next();
            if (!sample)
                continue;
            wrong += sample->a <= last || sample->b != 2 * sample->a;
            last = sample->a;
            ++read;
        }
    });
    while (!runs)
        std::this_thread::yield();
    Demo message;
    for (std::uint32_t a = 1; a <= SAMPLES; ++a) {
        message.a = a;
        message.b = 2 * a;
        unsent += publisher.publish(message) != SHMGEN_OK;
    }
    reader.join();
    wrong += unsent;
    std::printf("%lu wrong; read and missed: %lu\n", wrong, read + subscriber.missed());
    end.base = static_cast<unsigned char *>(mmap(own, static_cast<std::size_t>(end.size), PROT_READ, MAP_PRIVATE | MAP_ANONYMOUS, -1, 0));
    return wrong != 0;
}
