// Client and server of the service Ask and of the action Count, told what to do by lines on stdin.
//
//   serve TOPIC MS     answers 3 q + 1 after so many ms as `cycles` says, fails where `fail` is set; says its last status
//   client TOPIC, ask QUESTION CYCLES FAIL MS, send QUESTION CYCLES, poll, ready MS
//   act TOPIC MS       counts to the target, a step a ms
//   goals TOPIC, goal TARGET STRIDE MS, cancel, result MS, progress
#include "shm_plc_calls/calls_msgs/action/count_action.hpp"
#include "shm_plc_calls/calls_msgs/srv/ask_service.hpp"

#include <iostream>
#include <sstream>

namespace {

using std::chrono::milliseconds;
namespace srv = shm_plc_calls::calls_msgs::srv;
namespace action = shm_plc_calls::calls_msgs::action;

std::optional<srv::Ask_Response> answered(const srv::Ask_Request &request)
{
    shmgen_pause(static_cast<std::int64_t>(request.cycles) * SHMGEN_MS);
    if (request.fail)
        return std::nullopt;
    srv::Ask_Response response;
    response.answer = 3 * request.question + 1;
    response.copies.fill(response.answer);
    return response;
}

void count(action::CountActionServer::Goal &goal)
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

std::string said(shmgen::Status status) { return std::to_string(status.code()); }

} // namespace

int main()
{
    srv::AskServer server;
    srv::AskClient client;
    action::CountActionServer counter;
    action::CountActionClient goals;
    for (std::string line; std::getline(std::cin, line);) {
        std::istringstream words(line);
        std::string verb, topic;
        long one = 0, two = 0, three = 0, four = 0;
        words >> verb;
        if (verb == "serve" || verb == "client" || verb == "act" || verb == "goals")
            words >> topic;
        words >> one >> two >> three >> four;
        std::string text;
        if (verb == "serve") {
            std::cout << said(server.open(topic)) << std::endl;
            text = said(server.serve(answered, milliseconds(one)));
            server.close();
        } else if (verb == "act") {
            std::cout << said(counter.open(topic)) << std::endl;
            text = said(counter.serve(count, milliseconds(one)));
            counter.close();
        } else if (verb == "client") {
            text = said(client.open(topic));
        } else if (verb == "goals") {
            text = said(goals.open(topic));
        } else if (verb == "ask" || verb == "send") {
            srv::Ask_Request request;
            request.question = static_cast<std::uint64_t>(one);
            request.cycles = static_cast<std::uint32_t>(two);
            request.fail = three != 0;
            if (verb == "send") {
                text = said(client.send(request));
            } else {
                const auto response = client.call(request, milliseconds(four));
                text = said(client.status()) + (response ? " " + std::to_string(response->copies[15]) : "");
            }
        } else if (verb == "poll") {
            const auto response = client.poll();
            text = said(client.status()) + (response ? " " + std::to_string(response->answer) : "");
        } else if (verb == "ready") {
            text = std::to_string(client.wait_for_server(milliseconds(one)));
        } else if (verb == "goal") {
            action::Count_Goal goal;
            goal.target = static_cast<std::uint32_t>(one);
            goal.stride = static_cast<std::uint32_t>(two);
            text = said(goals.send_goal(goal, milliseconds(three)));
        } else if (verb == "cancel") {
            text = said(goals.cancel());
        } else if (verb == "progress") {
            const auto feedback = goals.feedback();
            text = std::to_string(goals.goal_status()) + (feedback ? " " + std::to_string(feedback->position) : "");
        } else if (verb == "result") {
            const auto outcome = goals.result(milliseconds(one));
            text = said(goals.status());
            if (outcome)
                text += " " + std::to_string(outcome->status) + " " + std::to_string(outcome->result.reached);
        }
        std::cout << text << std::endl;
    }
}
