// A 1 kHz control loop like that of ros2_control, without ROS: read the state, compute, write the command. No call in
// the loop blocks, allocates memory or throws. Uses SCHED_FIFO and locked memory if this user has the rights.
//
//   loop SECONDS
#include "shm_msgs/sensor_msgs/msg/joint_state.hpp"
#include "shm_msgs/std_msgs/msg/float64.hpp"

#include <algorithm>
#include <cstdio>
#include <cstdlib>
#include <sys/mman.h>
#include <thread>

using namespace std::chrono_literals;
using shm_msgs::sensor_msgs::msg::JointState;
using shm_msgs::sensor_msgs::msg::JointStateSubscriber;
using shm_msgs::std_msgs::msg::Float64;
using shm_msgs::std_msgs::msg::Float64Publisher;

namespace {

constexpr auto PERIOD = 1ms;
constexpr auto STALE = 100ms; // the command is 0 if the PLC is silent for longer

// Imitates a hardware interface of ros2_control: the loop calls read, update and write in turn.
class Joint {
public:
    Joint() : state_("/shmgen_loop/joints"), command_("/shmgen_loop/command") {}
    void read() noexcept
    {
        if (const auto sample = state_.try_read())
            if (const double *position = sample->position.find(0))
                position_ = *position;
        lost_ = state_.is_stale(STALE);
    }
    void update(double wanted) noexcept { effort_.data = lost_ ? 0.0 : 10.0 * (wanted - position_); }
    bool write() noexcept { return bool(command_.try_publish(effort_)); }
    std::uint64_t missed() const noexcept { return state_.missed(); }

private:
    JointStateSubscriber state_;
    Float64Publisher command_;
    Float64 effort_;
    double position_ = 0.0;
    bool lost_ = true;
};

} // namespace

int main(int count, char **words)
{
    const auto cycles = static_cast<std::size_t>((count > 1 ? std::atof(words[1]) : 10.0) * 1000);
    Joint joint;
    std::vector<double> late(cycles); // us; the only allocation, before the loop begins

    sched_param priority{};
    priority.sched_priority = 80;
    const bool fifo = sched_setscheduler(0, SCHED_FIFO, &priority) == 0;
    const bool locked = mlockall(MCL_CURRENT | MCL_FUTURE) == 0;

    std::size_t unsent = 0;
    auto next = std::chrono::steady_clock::now() + PERIOD;
    for (double &lateness : late) {
        std::this_thread::sleep_until(next);
        lateness = std::chrono::duration<double, std::micro>(std::chrono::steady_clock::now() - next).count();
        joint.read();
        joint.update(1.0);
        unsent += joint.write() ? 0 : 1;
        next += PERIOD;
    }

    std::sort(late.begin(), late.end());
    std::printf("%zu cycles, %zu not sent; SCHED_FIFO %s, memory %s\n", cycles, unsent, fifo ? "yes" : "not allowed",
                locked ? "locked" : "not locked");
    std::printf("start delay: %.0f us (median), %.0f us (99 %%), %.0f us (longest)\n", late[cycles / 2],
                late[cycles * 99 / 100], late.back());
    return unsent == 0 ? 0 : 1;
}
