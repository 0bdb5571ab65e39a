// A small controller_manager: a ResourceManager loads a URDF and its plugin. Each cycle reads, computes and writes.
//
//     loop <urdf> <cycles> <enable>
//
// In cycle i, the command of joint j (0 to 5) is i + j / 8. The PLC must return all six positions of one cycle in one
// sample. The loop ends at the first error, and prints the result as JSON.
#include <hardware_interface/resource_manager.hpp>
#include <rclcpp/rclcpp.hpp>

#include <algorithm>
#include <chrono>
#include <cstdio>
#include <fstream>
#include <sstream>
#include <thread>

using Clock = std::chrono::steady_clock;

static const std::size_t JOINTS = 6;
static const double MAX_DELAY = 20; // cycles; an older position counts as late

static double percentile(const std::vector<double> &sorted, double fraction)
{
    return sorted.empty() ? 0 : sorted[static_cast<std::size_t>(fraction * static_cast<double>(sorted.size() - 1))];
}

int main(int, char **argv)
{
    rclcpp::init(0, nullptr);
    const auto node = std::make_shared<rclcpp::Node>("loop");
    std::ifstream file(argv[1]);
    std::stringstream urdf;
    urdf << file.rdbuf();
    hardware_interface::ResourceManager manager(
        urdf.str(), node->get_node_clock_interface(), node->get_node_logging_interface(), true, 1000);
    std::vector<hardware_interface::LoanedStateInterface> states;
    std::vector<hardware_interface::LoanedCommandInterface> commands;
    try {
        for (std::size_t joint = 1; joint <= JOINTS; ++joint) {
            states.push_back(manager.claim_state_interface("joint" + std::to_string(joint) + "/position"));
            commands.push_back(manager.claim_command_interface("joint" + std::to_string(joint) + "/position"));
        }
        for (const char *name : {"plc/reset", "plc/stop", "plc/enable"})
            commands.push_back(manager.claim_command_interface(name));
    } catch (const std::exception &error) { // the ResourceManager has logged the reason
        std::printf("{\"refused\": true}\n");
        std::fflush(stdout);
        std::_Exit(1);
    }
    std::puts("running");
    std::fflush(stdout);
    const long cycles = std::stol(argv[2]);
    const double enable = std::stod(argv[3]);
    long good_cycles = 0, new_positions = 0, wrong_positions = 0, late_positions = 0;
    double newest_position = 0;
    std::vector<double> durations; // us from read to write, of each cycle
    auto next = Clock::now();
    const char *failed_call = "";
    for (long cycle = 1; cycle <= cycles && !*failed_call; ++cycle) {
        std::this_thread::sleep_until(next += std::chrono::milliseconds(1));
        const auto cycle_start = Clock::now();
        const auto now = node->now();
        const auto period = rclcpp::Duration::from_seconds(0.001);
        if (!manager.read(now, period).ok)
            failed_call = "read";
        double first_position = 0;
        if (states[0].get_value(first_position) && first_position >= 1) {
            for (std::size_t joint = 1; joint < JOINTS; ++joint) {
                double position = 0;
                const double expected = first_position + static_cast<double>(joint) / 8.0;
                wrong_positions += !states[joint].get_value(position) || position != expected;
            }
            new_positions += first_position > newest_position;
            late_positions += first_position < static_cast<double>(cycle) - MAX_DELAY;
            newest_position = first_position;
        }
        for (std::size_t joint = 0; joint < JOINTS; ++joint)
            (void)commands[joint].set_value(static_cast<double>(cycle) + static_cast<double>(joint) / 8.0);
        (void)commands[JOINTS].set_value(0.0);     // reset
        (void)commands[JOINTS + 1].set_value(0.0); // stop
        (void)commands[JOINTS + 2].set_value(enable);
        if (!*failed_call && !manager.write(now, period).ok)
            failed_call = "write";
        durations.push_back(std::chrono::duration<double, std::micro>(Clock::now() - cycle_start).count());
        good_cycles += !*failed_call;
    }
    std::sort(durations.begin(), durations.end());
    std::printf("{\"good_cycles\": %ld, \"new_positions\": %ld, \"wrong_positions\": %ld, \"late_positions\": %ld, "
                "\"failed_call\": \"%s\", \"cycle_us\": [%.1f, %.1f, %.1f]}\n",
                good_cycles, new_positions, wrong_positions, late_positions, failed_call, percentile(durations, 0.5),
                percentile(durations, 0.99), percentile(durations, 1.0));
    std::fflush(stdout);
    std::_Exit(0);
}
