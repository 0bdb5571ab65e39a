// Client and server of the service Ask and of the action Count. Each line on stdin is a command; its status is printed.
//
// * `serve TOPIC MS` serves for MS. It answers 3 * question + 1 after `cycles` ms, or fails if `fail` is set.
// * `client TOPIC`, `ask QUESTION CYCLES FAIL MS`, `send QUESTION CYCLES`, `poll`, `ready MS`
// * `act TOPIC MS` executes goals for MS. It counts to the target, one stride per ms.
// * `goals TOPIC`, `goal TARGET STRIDE MS`, `cancel`, `result MS`, `progress`
#include "shm_plc_calls/calls_msgs/action/count_action.hpp"
#include "shm_plc_calls/calls_msgs/srv/ask_service.hpp"

#include <iostream>
#include <sstream>

namespace {

using std::chrono::milliseconds;
namespace srv = shm_plc_calls::calls_msgs::srv;
namespace action = shm_plc_calls::calls_msgs::action;

std::optional<srv::Ask_Response> answer(const srv::Ask_Request &request)
{
    shmgen_pause(static_cast<std::int64_t>(request.cycles) * SHMGEN_MS);
    if (request.fail)
        return std::nullopt;
    srv::Ask_Response response;
    response.answer = 3 * request.question + 1;
    response.copies.fill(response.answer);
    return response;
}

void execute_goal(action::CountActionServer::Goal &goal)
{
    action::Count_Result result;
    action::Count_Feedback feedback;
    if (goal.request.stride == 0) {
        (void)goal.reject();
        return;
    }
    while (result.reached < goal.request.target) {
        if (goal.is_cancel_requested()) {
            (void)goal.canceled(result);
            return;
        }
        result.reached += goal.request.stride;
        feedback.position = result.reached;
        (void)goal.publish_feedback(feedback);
        shmgen_pause(SHMGEN_MS);
    }
    (void)goal.succeed(result);
}

std::string code_of(shmgen::Status status) { return std::to_string(status.code()); }

} // namespace

int main()
{
    srv::AskServer ask_server;
    srv::AskClient ask_client;
    action::CountActionServer count_server;
    action::CountActionClient count_client;
    for (std::string line; std::getline(std::cin, line);) {
        std::istringstream words(line);
        std::string command, topic;
        long first = 0, second = 0, third = 0, fourth = 0;
        words >> command;
        if (command == "serve" || command == "client" || command == "act" || command == "goals")
            words >> topic;
        words >> first >> second >> third >> fourth;
        std::string output;
        if (command == "serve") {
            std::cout << code_of(ask_server.open(topic)) << std::endl;
            output = code_of(ask_server.serve(answer, milliseconds(first)));
            ask_server.close();
        } else if (command == "act") {
            std::cout << code_of(count_server.open(topic)) << std::endl;
            output = code_of(count_server.serve(execute_goal, milliseconds(first)));
            count_server.close();
        } else if (command == "client") {
            output = code_of(ask_client.open(topic));
        } else if (command == "goals") {
            output = code_of(count_client.open(topic));
        } else if (command == "ask" || command == "send") {
            srv::Ask_Request request;
            request.question = static_cast<std::uint64_t>(first);
            request.cycles = static_cast<std::uint32_t>(second);
            request.fail = third != 0;
            if (command == "send") {
                output = code_of(ask_client.send(request));
            } else {
                const auto response = ask_client.call(request, milliseconds(fourth));
                output = code_of(ask_client.status()) + (response ? " " + std::to_string(response->copies[15]) : "");
            }
        } else if (command == "poll") {
            const auto response = ask_client.poll();
            output = code_of(ask_client.status()) + (response ? " " + std::to_string(response->answer) : "");
        } else if (command == "ready") {
            output = std::to_string(ask_client.wait_for_server(milliseconds(first)));
        } else if (command == "goal") {
            action::Count_Goal goal;
            goal.target = static_cast<std::uint32_t>(first);
            goal.stride = static_cast<std::uint32_t>(second);
            output = code_of(count_client.send_goal(goal, milliseconds(third)));
        } else if (command == "cancel") {
            output = code_of(count_client.cancel());
        } else if (command == "progress") {
            const auto feedback = count_client.feedback();
            output = std::to_string(count_client.goal_status()) + (feedback ? " " + std::to_string(feedback->position) : "");
        } else if (command == "result") {
            const auto outcome = count_client.result(milliseconds(first));
            output = code_of(count_client.status());
            if (outcome)
                output += " " + std::to_string(outcome->status) + " " + std::to_string(outcome->result.reached);
        }
        std::cout << output << std::endl;
    }
}
