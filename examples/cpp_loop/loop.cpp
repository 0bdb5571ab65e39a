// A 1 kHz control loop like that of ros2_control, without ROS: read the state, compute, write the command. No call in
// the loop blocks, allocates memory or throws. Uses SCHED_FIFO and locked memory if this user has the permissions.
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
constexpr auto STALE_TIMEOUT = 100ms; // after this time without a heartbeat of the PLC, the command is 0
constexpr double GAIN = 10.0;         // 1/s, of the position controller
constexpr double TARGET = 1.0;        // rad

// Imitates a hardware interface of ros2_control: the loop calls read, update and write in turn.
class Joint {
public:
    Joint() : state_subscriber_("/shmgen_loop/joints"), command_publisher_("/shmgen_loop/command") {}
    void read() noexcept
    {
        if (const auto sample = state_subscriber_.try_read())
            if (const double *position = sample->position.find(0))
                position_ = *position;
        plc_is_stale_ = state_subscriber_.is_stale(STALE_TIMEOUT);
    }
    void update(double target) noexcept { velocity_.data = plc_is_stale_ ? 0.0 : GAIN * (target - position_); }
    // Returns false if the command was not sent.
    bool write() noexcept { return bool(command_publisher_.try_publish(velocity_)); }

private:
    JointStateSubscriber state_subscriber_;
    Float64Publisher command_publisher_;
    Float64 velocity_;       // rad/s, the command
    double position_ = 0.0;  // rad
    bool plc_is_stale_ = true;
};

} // namespace

int main(int argc, char **argv)
{
    const auto cycles = static_cast<std::size_t>((argc > 1 ? std::atof(argv[1]) : 10.0) * 1000);
    Joint joint;
    std::vector<double> start_delays(cycles); // us; the only allocation, before the loop begins

    sched_param priority{};
    priority.sched_priority = 80;
    const bool is_fifo = sched_setscheduler(0, SCHED_FIFO, &priority) == 0;
    const bool is_locked = mlockall(MCL_CURRENT | MCL_FUTURE) == 0;

    std::size_t unsent_commands = 0;
    auto next = std::chrono::steady_clock::now() + PERIOD;
    for (double &delay : start_delays) {
        std::this_thread::sleep_until(next);
        delay = std::chrono::duration<double, std::micro>(std::chrono::steady_clock::now() - next).count();
        joint.read();
        joint.update(TARGET);
        unsent_commands += joint.write() ? 0 : 1;
        next += PERIOD;
    }

    std::sort(start_delays.begin(), start_delays.end());
    std::printf("%zu cycles, %zu not sent; SCHED_FIFO %s, memory %s\n", cycles, unsent_commands,
                is_fifo ? "yes" : "not allowed", is_locked ? "locked" : "not locked");
    std::printf("start delay: %.0f us (median), %.0f us (99 %%), %.0f us (longest)\n", start_delays[cycles / 2],
                start_delays[cycles * 99 / 100], start_delays.back());
    return unsent_commands == 0 ? 0 : 1;
}
