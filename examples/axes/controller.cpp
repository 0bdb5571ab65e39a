// A controller of six axes at 1 kHz, like the hardware interface of a robot. It resets, enables, moves and disables the
// axes. If the PLC stops publishing, the controller commands no motion. After a restart of the PLC, it resets first.
//
//   controller SECONDS
#include "shm_msgs/axes_msgs/msg/axes_command.hpp"
#include "shm_msgs/axes_msgs/msg/axes_state.hpp"

#include <cmath>
#include <cstdio>
#include <cstdlib>
#include <sys/mman.h>
#include <thread>

using namespace std::chrono_literals;
using namespace shm_msgs::axes_msgs::msg;

int main(int argc, char **argv)
{
    const auto cycles = static_cast<std::size_t>((argc > 1 ? std::atof(argv[1]) : 10.0) * 1000);
    AxesCommandPublisher command_publisher("/axes/command");
    AxesStateSubscriber state_subscriber("/axes/state");
    AxesCommand command;
    AxesState state;
    std::size_t unsent_commands = 0, received_states = 0, stale_count = 0;
    bool plc_is_stale = true;

    sched_param priority{};
    priority.sched_priority = 80;
    sched_setscheduler(0, SCHED_FIFO, &priority); // takes effect only if this user has the permission
    mlockall(MCL_CURRENT | MCL_FUTURE);
    auto next = std::chrono::steady_clock::now();
    for (std::size_t cycle = 0; cycle < cycles; cycle++) {
        std::this_thread::sleep_until(next += 1ms);
        if (const auto sample = state_subscriber.try_read()) {
            state = *sample;
            received_states++;
        }
        if (state_subscriber.is_stale(50ms) != plc_is_stale) {
            plc_is_stale = !plc_is_stale;
            stale_count += plc_is_stale ? 1 : 0;
            std::printf("%s at %zu ms\n", plc_is_stale ? "PLC stale" : "PLC alive", cycle);
            std::fflush(stdout);
        }
        const bool is_ending = cycle + 500 > cycles; // the axes come to rest in the last 0.5 s, and are disabled
        command.reset = !plc_is_stale && state.state == AxesState::FAULT && cycle % 2 == 0;
        command.enable = !plc_is_stale && !is_ending && state.state != AxesState::FAULT &&
                         state.state != AxesState::STOPPING;
        for (std::size_t axis = 0; axis < command.position.size(); axis++)
            command.position[axis] = std::sin(0.002 * static_cast<double>(cycle) + static_cast<double>(axis));
        unsent_commands += command_publisher.try_publish(command) ? 0 : 1;
    }
    std::printf("%zu cycles, %zu commands not sent, %zu states received, PLC stale %zu times, final state %d\n", cycles,
                unsent_commands, received_states, stale_count, int(state.state));
    return unsent_commands == 0 ? 0 : 1;
}
