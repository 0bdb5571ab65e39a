// Run a hardware component at 1 kHz and change its state and commands as the lines of the standard input request.
//
//     activate | deactivate | set <count> <value>    (`set` sets the first commands: six positions, reset, stop, enable)
#include <hardware_interface/resource_manager.hpp>
#include <lifecycle_msgs/msg/state.hpp>
#include <rclcpp/rclcpp.hpp>

#include <poll.h>

#include <chrono>
#include <cstdio>
#include <fstream>
#include <iostream>
#include <sstream>
#include <thread>

using lifecycle_msgs::msg::State;

static void report(const char *line)
{
    std::puts(line);
    std::fflush(stdout);
}

int main(int, char **words)
{
    rclcpp::init(0, nullptr);
    const auto node = std::make_shared<rclcpp::Node>("reactivate");
    std::ifstream file(words[1]);
    std::stringstream urdf;
    urdf << file.rdbuf();
    hardware_interface::ResourceManager manager(
        urdf.str(), node->get_node_clock_interface(), node->get_node_logging_interface(), true, 1000);
    std::vector<hardware_interface::LoanedCommandInterface> commands;
    for (int joint = 1; joint <= 6; ++joint)
        commands.push_back(manager.claim_command_interface("joint" + std::to_string(joint) + "/position"));
    for (const char *name : {"plc/reset", "plc/stop", "plc/enable"})
        commands.push_back(manager.claim_command_interface(name));
    report("running");
    for (;;) {
        std::this_thread::sleep_for(std::chrono::milliseconds(1));
        pollfd input{0, POLLIN, 0};
        std::string line, action;
        if (poll(&input, 1, 0) == 1) {
            if (!std::getline(std::cin, line))
                std::_Exit(0);
            std::istringstream request(line);
            std::size_t count = 0;
            double value = 0;
            request >> action >> count >> value;
            for (std::size_t command = 0; command < count; ++command)
                while (!commands[command].set_value(value))
                    std::this_thread::yield();
            rclcpp_lifecycle::State active(State::PRIMARY_STATE_ACTIVE, "active");
            rclcpp_lifecycle::State inactive(State::PRIMARY_STATE_INACTIVE, "inactive");
            if (action != "set")
                (void)manager.set_component_state("cell_control", action == "activate" ? active : inactive);
            report("done");
        }
        const auto period = rclcpp::Duration::from_seconds(0.001);
        if (!manager.read(node->now(), period).ok)
            report("failed");
        (void)manager.write(node->now(), period);
    }
}
