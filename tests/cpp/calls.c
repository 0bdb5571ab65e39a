/* Client and server of the service Ask and of the action Count in C: the same lines as calls.cpp, the same answers. */
#include "shm_plc_calls/calls_msgs/action/count_action.h"
#include "shm_plc_calls/calls_msgs/srv/ask_service.h"

#include <inttypes.h>
#include <stdio.h>

static shm_calls_msgs_Ask_server server;
static shm_calls_msgs_Ask_client client;
static shm_calls_msgs_Count_action_server counter;
static shm_calls_msgs_Count_action_client goals;

static void say(shmgen_status status)
{
    printf("%d\n", (int)status);
    fflush(stdout);
}

static shmgen_status serve(int64_t ns)
{
    const int64_t end = shmgen_until(ns);
    for (;;) {
        shm_calls_msgs_Ask_Request request;
        shm_calls_msgs_Ask_Reply reply;
        shmgen_status status = shm_calls_msgs_Ask_server_take(&server, &request, shmgen_left(end));
        if (status != SHMGEN_OK)
            return status;
        shmgen_pause((int64_t)request.cycles * SHMGEN_MS);
        reply.response.answer = 3 * request.question + 1;
        for (int index = 0; index < 16; index++)
            reply.response.copies[index] = reply.response.answer;
        if (request.fail)
            shm_calls_msgs_Ask_server_fail(&server, shmgen_left(end));
        else
            shm_calls_msgs_Ask_server_reply(&server, &reply, shmgen_left(end));
    }
}

static void count(const shm_calls_msgs_Count_Goal *goal)
{
    shm_calls_msgs_Count_Outcome outcome;
    shm_calls_msgs_Count_Progress progress;
    uint32_t reached = 0;
    int8_t how = SHMGEN_GOAL_SUCCEEDED;
    if (goal->stride == 0) {
        shm_calls_msgs_Count_action_server_end(&counter, SHMGEN_GOAL_REJECTED, NULL, SHMGEN_MS);
        return;
    }
    while (reached < goal->target && how == SHMGEN_GOAL_SUCCEEDED) {
        if (shm_calls_msgs_Count_action_server_is_cancel_requested(&counter)) {
            how = SHMGEN_GOAL_CANCELED;
        } else {
            reached += goal->stride;
            progress.feedback.position = reached;
            shm_calls_msgs_Count_action_server_feedback(&counter, &progress, SHMGEN_MS);
            shmgen_pause(SHMGEN_MS);
        }
    }
    outcome.result.reached = reached;
    shm_calls_msgs_Count_action_server_end(&counter, how, &outcome, SHMGEN_MS);
}

static shmgen_status act(int64_t ns)
{
    const int64_t end = shmgen_until(ns);
    for (;;) {
        shm_calls_msgs_Count_Command command;
        const shmgen_status status = shm_calls_msgs_Count_action_server_take(&counter, &command, shmgen_left(end));
        if (status != SHMGEN_OK)
            return status;
        shm_calls_msgs_Count_action_server_accept(&counter, shmgen_left(end));
        count(&command.goal);
    }
}

static void call(const char *verb, long question, long cycles, long fail, long ms)
{
    shm_calls_msgs_Ask_Request request = {0};
    shm_calls_msgs_Ask_Reply reply;
    shmgen_status status;
    request.question = (uint64_t)question;
    request.cycles = (uint32_t)cycles;
    request.fail = fail != 0;
    if (strcmp(verb, "send") == 0) {
        say(shm_calls_msgs_Ask_client_send(&client, &request));
        return;
    }
    status = strcmp(verb, "ask") == 0 ? shm_calls_msgs_Ask_client_call(&client, &request, &reply, ms * SHMGEN_MS)
                                      : shm_calls_msgs_Ask_client_poll(&client, &reply);
    if (status == SHMGEN_OK)
        printf("0 %" PRIu64 "\n", reply.response.copies[15]);
    else
        say(status);
}

static void look(void)
{
    static int status;
    shm_calls_msgs_Count_Progress progress;
    if (shm_calls_msgs_Count_action_client_progress(&goals, &progress) != SHMGEN_OK) {
        printf("%d\n", status);
    } else if ((status = progress.status) == SHMGEN_GOAL_ACCEPTED) {
        printf("%d\n", status);
    } else {
        printf("%d %u\n", status, (unsigned)progress.feedback.position);
    }
}

static void end(long ms)
{
    shm_calls_msgs_Count_Outcome outcome;
    const shmgen_status status = shm_calls_msgs_Count_action_client_wait(&goals, &outcome, ms * SHMGEN_MS);
    if (status == SHMGEN_OK)
        printf("0 %d %u\n", outcome.status, (unsigned)outcome.result.reached);
    else
        say(status == SHMGEN_NOTHING_NEW ? SHMGEN_CALL_TIMEOUT : status);
}

int main(void)
{
    char line[512], verb[16], topic[256];
    while (fgets(line, sizeof line, stdin) != NULL) {
        long one = 0, two = 0, three = 0, four = 0;
        shm_calls_msgs_Count_Command command = {0};
        sscanf(line, "%15s", verb);
        if (strcmp(verb, "serve") == 0 || strcmp(verb, "client") == 0 || strcmp(verb, "act") == 0 ||
            strcmp(verb, "goals") == 0)
            sscanf(line, "%*s %255s %ld", topic, &one);
        else
            sscanf(line, "%*s %ld %ld %ld %ld", &one, &two, &three, &four);
        if (strcmp(verb, "serve") == 0) {
            say(shm_calls_msgs_Ask_server_open(&server, topic, NULL));
            say(serve(one * SHMGEN_MS));
            shm_calls_msgs_Ask_server_close(&server);
        } else if (strcmp(verb, "act") == 0) {
            say(shm_calls_msgs_Count_action_server_open(&counter, topic, NULL));
            say(act(one * SHMGEN_MS));
            shm_calls_msgs_Count_action_server_close(&counter);
        } else if (strcmp(verb, "client") == 0) {
            say(shm_calls_msgs_Ask_client_open(&client, topic, NULL));
        } else if (strcmp(verb, "goals") == 0) {
            say(shm_calls_msgs_Count_action_client_open(&goals, topic, NULL));
        } else if (strcmp(verb, "ready") == 0) {
            printf("%d\n", shmgen_client_wait_for_server(&client.end, one * SHMGEN_MS) == SHMGEN_OK);
        } else if (strcmp(verb, "goal") == 0) {
            command.goal.target = (uint32_t)one;
            command.goal.stride = (uint32_t)two;
            say(shm_calls_msgs_Count_action_client_send_goal(&goals, &command, three * SHMGEN_MS));
        } else if (strcmp(verb, "cancel") == 0) {
            say(shm_calls_msgs_Count_action_client_cancel(&goals));
        } else if (strcmp(verb, "progress") == 0) {
            look();
        } else if (strcmp(verb, "result") == 0) {
            end(one);
        } else {
            call(verb, one, two, three, four);
        }
        fflush(stdout);
    }
    shm_calls_msgs_Ask_client_close(&client);
    shm_calls_msgs_Count_action_client_close(&goals);
    return 0;
}
