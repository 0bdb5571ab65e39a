// A small controller_manager: a ResourceManager loads a URDF and its plugin. Each cycle reads, computes and writes.
//
//     control_loop <urdf> <cycles> <enable>
//
// In cycle i the command of joint j is i + j / 8. The loop ends at the first error and prints the result as JSON.
#include <hardware_interface/resource_manager.hpp>
#include <rclcpp/rclcpp.hpp>

#include <algorithm>
#include <chrono>
#include <cstdio>
#include <fstream>
#include <sstream>
#include <thread>

using Clock = std::chrono::steady_clock;

static double at(std::vector<double> &sorted, double share)
{
    return sorted.empty() ? 0 : sorted[static_cast<std::size_t>(share * static_cast<double>(sorted.size() - 1))];
}

int main(int, char **words)
{
    rclcpp::init(0, nullptr);
    const auto node = std::make_shared<rclcpp::Node>("loop");
    std::ifstream file(words[1]);
    std::stringstream urdf;
    urdf << file.rdbuf();
    hardware_interface::ResourceManager manager(
        urdf.str(), node->get_node_clock_interface(), node->get_node_logging_interface(), true, 1000);
    std::vector<hardware_interface::LoanedStateInterface> states;
    std::vector<hardware_interface::LoanedCommandInterface> commands;
    try {
        for (int joint = 1; joint <= 6; ++joint) {
            states.push_back(manager.claim_state_interface("joint" + std::to_string(joint) + "/position"));
            commands.push_back(manager.claim_command_interface("joint" + std::to_string(joint) + "/position"));
        }
        for (const char *name : {"plc/reset", "plc/stop", "plc/enable"})
            commands.push_back(manager.claim_command_interface(name));
    } catch (const std::exception &error) {
        std::printf("{\"refused\": true}\n");
        std::fflush(stdout);
        std::_Exit(1);
    }
    std::puts("running");
    std::fflush(stdout);
    const long cycles = std::stol(words[2]);
    long ok = 0, answered = 0, wrong = 0, late = 0;
    double newest = 0;
    std::vector<double> took;
    auto next = Clock::now();
    const char *failed = "";
    for (long cycle = 1; cycle <= cycles && !*failed; ++cycle) {
        std::this_thread::sleep_until(next += std::chrono::milliseconds(1));
        const auto begun = Clock::now();
        const auto now = node->now();
        const auto period = rclcpp::Duration::from_seconds(0.001);
        if (!manager.read(now, period).ok)
            failed = "read";
        double first = 0;
        if (states[0].get_value(first) && first >= 1) {
            for (int joint = 1; joint < 6; ++joint) {
                double position = 0;
                wrong += !states[static_cast<std::size_t>(joint)].get_value(position) || position != first + joint / 8.0;
            }
            answered += first > newest;
            late += first < static_cast<double>(cycle) - 20;
            newest = first;
        }
        for (std::size_t joint = 0; joint < 6; ++joint)
            (void)commands[joint].set_value(static_cast<double>(cycle) + static_cast<double>(joint) / 8.0);
        (void)commands[6].set_value(0.0);
        (void)commands[7].set_value(0.0);
        (void)commands[8].set_value(std::stod(words[3]));
        if (!*failed && !manager.write(now, period).ok)
            failed = "write";
        took.push_back(std::chrono::duration<double, std::micro>(Clock::now() - begun).count());
        ok += !*failed;
    }
    std::sort(took.begin(), took.end());
    std::printf("{\"ok\": %ld, \"answered\": %ld, \"wrong\": %ld, \"late\": %ld, \"failed\": \"%s\", \"us\": [%.1f, %.1f, %.1f]}\n", ok, answered, wrong,
                late, failed, at(took, 0.5), at(took, 0.99), at(took, 1.0));
    std::fflush(stdout);
    std::_Exit(0);
}
