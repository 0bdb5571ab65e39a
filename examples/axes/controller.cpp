// A controller of six axes at 1 kHz, like the hardware interface of a robot: reset, enable, move, disable. It stops
// commanding motion when the PLC stops publishing, and begins with a reset when the PLC is back.
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

int main(int count, char **words)
{
    const auto cycles = static_cast<std::size_t>((count > 1 ? std::atof(words[1]) : 10.0) * 1000);
    AxesCommandPublisher commands("/axes/command");
    AxesStateSubscriber states("/axes/state");
    AxesCommand command;
    AxesState state;
    std::size_t unsent = 0, heard = 0, lost = 0;
    bool silent = true;

    sched_param priority{};
    priority.sched_priority = 80;
    sched_setscheduler(0, SCHED_FIFO, &priority); // takes effect only if this user has the right
    mlockall(MCL_CURRENT | MCL_FUTURE);
    auto next = std::chrono::steady_clock::now();
    for (std::size_t cycle = 0; cycle < cycles; cycle++) {
        std::this_thread::sleep_until(next += 1ms);
        if (const auto sample = states.try_read()) {
            state = *sample;
            heard++;
        }
        if (states.is_stale(50ms) != silent) {
            silent = !silent;
            lost += silent ? 1 : 0;
            std::printf("%s at %zu ms\n", silent ? "PLC stale" : "PLC alive", cycle);
            std::fflush(stdout);
        }
        const bool last = cycle + 500 > cycles; // come to rest, then disable
        command.reset = !silent && state.state == AxesState::FAULT && cycle % 2 == 0;
        command.enable = !silent && !last && state.state != AxesState::FAULT && state.state != AxesState::STOPPING;
        for (std::size_t axis = 0; axis < command.position.size(); axis++)
            command.position[axis] = std::sin(0.002 * static_cast<double>(cycle) + static_cast<double>(axis));
        unsent += commands.try_publish(command) ? 0 : 1;
    }
    std::printf("%zu cycles, %zu commands not sent, %zu states received, PLC stale %zu times, final state %d\n", cycles,
                unsent, heard, lost, int(state.state));
    return unsent == 0 ? 0 : 1;
}
