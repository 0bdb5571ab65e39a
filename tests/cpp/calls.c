/* Client and server of the service Ask and of the action Count in C. The commands and the output are those of calls.cpp. */
#include "shm_plc_calls/calls_msgs/action/count_action.h"
#include "shm_plc_calls/calls_msgs/srv/ask_service.h"

#include <inttypes.h>
#include <stdio.h>

static shm_calls_msgs_Ask_server ask_server;
static shm_calls_msgs_Ask_client ask_client;
static shm_calls_msgs_Count_action_server count_server;
static shm_calls_msgs_Count_action_client count_client;

static void print_status(shmgen_status status)
{
    printf("%d\n", (int)status);
    fflush(stdout);
}

static shmgen_status serve_requests(int64_t ns)
{
    const int64_t deadline = shmgen_until(ns);
    for (;;) {
        shm_calls_msgs_Ask_Request request;
        shm_calls_msgs_Ask_Reply reply;
        shmgen_status status = shm_calls_msgs_Ask_server_take(&ask_server, &request, shmgen_left(deadline));
        if (status != SHMGEN_OK)
            return status;
        shmgen_pause((int64_t)request.cycles * SHMGEN_MS);
        reply.response.answer = 3 * request.question + 1;
        for (int index = 0; index < 16; index++)
            reply.response.copies[index] = reply.response.answer;
        if (request.fail)
            shm_calls_msgs_Ask_server_fail(&ask_server, shmgen_left(deadline));
        else
            shm_calls_msgs_Ask_server_reply(&ask_server, &reply, shmgen_left(deadline));
    }
}

static void execute_goal(const shm_calls_msgs_Count_Goal *goal)
{
    shm_calls_msgs_Count_Outcome outcome;
    shm_calls_msgs_Count_Progress progress;
    uint32_t reached = 0;
    int8_t goal_status = SHMGEN_GOAL_SUCCEEDED;
    if (goal->stride == 0) {
        shm_calls_msgs_Count_action_server_end(&count_server, SHMGEN_GOAL_REJECTED, NULL, SHMGEN_MS);
        return;
    }
    while (reached < goal->target && goal_status == SHMGEN_GOAL_SUCCEEDED) {
        if (shm_calls_msgs_Count_action_server_is_cancel_requested(&count_server)) {
            goal_status = SHMGEN_GOAL_CANCELED;
        } else {
            reached += goal->stride;
            progress.feedback.position = reached;
            shm_calls_msgs_Count_action_server_feedback(&count_server, &progress, SHMGEN_MS);
            shmgen_pause(SHMGEN_MS);
        }
    }
    outcome.result.reached = reached;
    shm_calls_msgs_Count_action_server_end(&count_server, goal_status, &outcome, SHMGEN_MS);
}

static shmgen_status serve_goals(int64_t ns)
{
    const int64_t deadline = shmgen_until(ns);
    for (;;) {
        shm_calls_msgs_Count_Command goal_command;
        const shmgen_status status = shm_calls_msgs_Count_action_server_take(&count_server, &goal_command, shmgen_left(deadline));
        if (status != SHMGEN_OK)
            return status;
        shm_calls_msgs_Count_action_server_accept(&count_server, shmgen_left(deadline));
        execute_goal(&goal_command.goal);
    }
}

static void call_service(const char *command, long question, long cycles, long fail, long ms)
{
    shm_calls_msgs_Ask_Request request = {0};
    shm_calls_msgs_Ask_Reply reply;
    shmgen_status status;
    request.question = (uint64_t)question;
    request.cycles = (uint32_t)cycles;
    request.fail = fail != 0;
    if (strcmp(command, "send") == 0) {
        print_status(shm_calls_msgs_Ask_client_send(&ask_client, &request));
        return;
    }
    status = strcmp(command, "ask") == 0 ? shm_calls_msgs_Ask_client_call(&ask_client, &request, &reply, ms * SHMGEN_MS)
                                         : shm_calls_msgs_Ask_client_poll(&ask_client, &reply);
    if (status == SHMGEN_OK)
        printf("0 %" PRIu64 "\n", reply.response.copies[15]);
    else
        print_status(status);
}

static void print_progress(void)
{
    static int status;
    shm_calls_msgs_Count_Progress progress;
    if (shm_calls_msgs_Count_action_client_progress(&count_client, &progress) != SHMGEN_OK) {
        printf("%d\n", status);
    } else if ((status = progress.status) == SHMGEN_GOAL_ACCEPTED) {
        printf("%d\n", status);
    } else {
        printf("%d %u\n", status, (unsigned)progress.feedback.position);
    }
}

static void print_result(long ms)
{
    shm_calls_msgs_Count_Outcome outcome;
    const shmgen_status status = shm_calls_msgs_Count_action_client_wait(&count_client, &outcome, ms * SHMGEN_MS);
    if (status == SHMGEN_OK)
        printf("0 %d %u\n", outcome.status, (unsigned)outcome.result.reached);
    else
        print_status(status == SHMGEN_NOTHING_NEW ? SHMGEN_CALL_TIMEOUT : status);
}

int main(void)
{
    char line[512], command[16], topic[256];
    while (fgets(line, sizeof line, stdin) != NULL) {
        long first = 0, second = 0, third = 0, fourth = 0;
        shm_calls_msgs_Count_Command goal_command = {0};
        sscanf(line, "%15s", command);
        if (strcmp(command, "serve") == 0 || strcmp(command, "client") == 0 || strcmp(command, "act") == 0 ||
            strcmp(command, "goals") == 0)
            sscanf(line, "%*s %255s %ld", topic, &first);
        else
            sscanf(line, "%*s %ld %ld %ld %ld", &first, &second, &third, &fourth);
        if (strcmp(command, "serve") == 0) {
            print_status(shm_calls_msgs_Ask_server_open(&ask_server, topic, NULL));
            print_status(serve_requests(first * SHMGEN_MS));
            shm_calls_msgs_Ask_server_close(&ask_server);
        } else if (strcmp(command, "act") == 0) {
            print_status(shm_calls_msgs_Count_action_server_open(&count_server, topic, NULL));
            print_status(serve_goals(first * SHMGEN_MS));
            shm_calls_msgs_Count_action_server_close(&count_server);
        } else if (strcmp(command, "client") == 0) {
            print_status(shm_calls_msgs_Ask_client_open(&ask_client, topic, NULL));
        } else if (strcmp(command, "goals") == 0) {
            print_status(shm_calls_msgs_Count_action_client_open(&count_client, topic, NULL));
        } else if (strcmp(command, "ready") == 0) {
            printf("%d\n", shmgen_client_wait_for_server(&ask_client.end, first * SHMGEN_MS) == SHMGEN_OK);
        } else if (strcmp(command, "goal") == 0) {
            goal_command.goal.target = (uint32_t)first;
            goal_command.goal.stride = (uint32_t)second;
            print_status(shm_calls_msgs_Count_action_client_send_goal(&count_client, &goal_command, third * SHMGEN_MS));
        } else if (strcmp(command, "cancel") == 0) {
            print_status(shm_calls_msgs_Count_action_client_cancel(&count_client));
        } else if (strcmp(command, "progress") == 0) {
            print_progress();
        } else if (strcmp(command, "result") == 0) {
            print_result(first);
        } else {
            call_service(command, first, second, third, fourth);
        }
        fflush(stdout);
    }
    shm_calls_msgs_Ask_client_close(&ask_client);
    shm_calls_msgs_Count_action_client_close(&count_client);
    return 0;
}
