// Measures Debian's iceoryx (libiceoryx-posh-dev) for latency.py. Samples are written and read in place.
//
//   iceoryx spin|event SIZE RATE SECONDS  prints the age of each sample in ns, then the CPU time in percent of a core
//
// The program starts iceoryx's daemon RouDi and the sender as child processes.
#include "iceoryx_hoofs/log/logmanager.hpp"
#include "iceoryx_posh/internal/roudi/roudi.hpp"
#include "iceoryx_posh/popo/publisher.hpp"
#include "iceoryx_posh/popo/subscriber.hpp"
#include "iceoryx_posh/popo/wait_set.hpp"
#include "iceoryx_posh/roudi/iceoryx_roudi_components.hpp"
#include "iceoryx_posh/runtime/posh_runtime.hpp"

#include <csignal>
#include <cstdio>
#include <cstring>
#include <sys/resource.h>
#include <sys/wait.h>
#include <time.h>
#include <unistd.h>
#include <vector>

namespace {

struct SmallBlock {
    std::uint64_t stamp;
    unsigned char data[48];
};

struct MediumBlock {
    std::uint64_t stamp;
    unsigned char data[312];
};

struct LargeBlock {
    std::uint64_t stamp;
    unsigned char data[(1 << 20) - 8];
};

// Return the time in ns of the monotonic clock, which all processes share.
std::uint64_t now()
{
    timespec t;
    clock_gettime(CLOCK_MONOTONIC, &t);
    return static_cast<std::uint64_t>(t.tv_sec) * 1000000000u + static_cast<std::uint64_t>(t.tv_nsec);
}

// Run the daemon RouDi, which manages the shared memory, until this process is killed.
[[noreturn]] void run_daemon()
{
    (void)!std::freopen("/dev/null", "w", stdout); // RouDi prints that it is ready
    iox::mepoo::MePooConfig pools;
    pools.addMemPool({128, 64});
    pools.addMemPool({1024, 64});
    pools.addMemPool({(1 << 20) + 128, 16});
    iox::RouDiConfig_t config;
    config.m_sharedMemorySegments.push_back({iox::posix::PosixGroup::getGroupOfCurrentProcess().getName(),
                                             iox::posix::PosixGroup::getGroupOfCurrentProcess().getName(), pools});
    iox::roudi::IceOryxRouDiComponents components(config);
    iox::roudi::RouDi roudi(components.rouDiMemoryManager, components.portManager,
                            iox::roudi::RouDi::RoudiStartupParameters{iox::roudi::MonitoringMode::OFF, false});
    for (;;)
        pause();
}

// Send samples at a fixed rate in Hz.
template <class Block> void send(double rate, double seconds)
{
    iox::runtime::PoshRuntime::initRuntime("sender");
    iox::popo::Publisher<Block> publisher({"shmgen", "benchmark", "block"});
    static Block block;
    const auto period = static_cast<std::uint64_t>(1e9 / rate);
    std::uint64_t due = now();
    for (int number = 1; number <= seconds * rate; number++) {
        due += period;
        const timespec due_time = {static_cast<time_t>(due / 1000000000), static_cast<long>(due % 1000000000)};
        clock_nanosleep(CLOCK_MONOTONIC, TIMER_ABSTIME, &due_time, nullptr);
        const std::uint64_t stamp = now();
        (void)publisher.loan().and_then([&](auto &sample) {
            std::memcpy(sample->data, block.data, sizeof block.data);
            sample->stamp = stamp;
            sample.publish();
        });
    }
}

// Print the age of each received sample and the CPU time of this process.
template <class Block> int receive(bool event)
{
    iox::runtime::PoshRuntime::initRuntime("receiver");
    iox::popo::SubscriberOptions options;
    options.queueCapacity = 1;
    iox::popo::Subscriber<Block> subscriber({"shmgen", "benchmark", "block"}, options);
    iox::popo::WaitSet<> wait_set;
    (void)wait_set.attachState(subscriber, iox::popo::SubscriberState::HAS_DATA);
    std::vector<std::uint64_t> ages;
    const std::uint64_t start = now();
    std::uint64_t last_arrival = start;
    // End 0.3 s after the last sample. A spinning reader reads the clock only every 65536 polls, like cpp.cpp.
    for (unsigned polls = 1; (!event && polls % 65536 != 0) || now() - last_arrival < 300000000u; polls++) {
        if (event && wait_set.timedWait(iox::units::Duration::fromMilliseconds(100)).empty())
            continue;
        (void)subscriber.take().and_then([&](auto &sample) {
            last_arrival = now();
            ages.push_back(last_arrival - sample->stamp);
        });
    }
    rusage usage;
    getrusage(RUSAGE_SELF, &usage);
    const double cpu_seconds = static_cast<double>(usage.ru_utime.tv_sec + usage.ru_stime.tv_sec) +
                               static_cast<double>(usage.ru_utime.tv_usec + usage.ru_stime.tv_usec) / 1e6;
    for (const std::uint64_t age : ages)
        std::printf("%lu\n", static_cast<unsigned long>(age));
    std::printf("%f\n", cpu_seconds / (static_cast<double>(now() - start) / 1e9) * 100);
    return 0;
}

template <class Block> int measure_stream(bool event, double rate, double seconds)
{
    iox::log::LogManager::GetLogManager().SetDefaultLogLevel(iox::log::LogLevel::kOff);
    const pid_t daemon = fork();
    if (daemon == 0)
        run_daemon();
    const pid_t sender = fork();
    if (sender == 0) {
        send<Block>(rate, seconds);
        _exit(0);
    }
    const int result = receive<Block>(event);
    waitpid(sender, nullptr, 0);
    std::fflush(stdout);
    kill(daemon, SIGKILL);
    waitpid(daemon, nullptr, 0);
    _exit(result); // skips the runtime's destructor, which would contact the ended daemon
}

} // namespace

int main(int, char **argv)
{
    const bool event = std::strcmp(argv[1], "event") == 0;
    const double rate = std::atof(argv[3]), seconds = std::atof(argv[4]);
    switch (std::atoi(argv[2])) {
    case sizeof(SmallBlock):
        return measure_stream<SmallBlock>(event, rate, seconds);
    case sizeof(MediumBlock):
        return measure_stream<MediumBlock>(event, rate, seconds);
    default:
        return measure_stream<LargeBlock>(event, rate, seconds);
    }
}
