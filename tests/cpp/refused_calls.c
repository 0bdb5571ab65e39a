/* Both ends of a service in one program: counts above their bounds, names that cannot be, ends that are not open. Prints
 * the line of what is not as it should be. */
#include "shm_refused/put_msgs/srv/put_service.h"

#include <stdio.h>

#define MUST(what, status) wrong += (what) != (status) && printf("line %d\n", __LINE__)

static shm_put_msgs_Put_server server;
static shm_put_msgs_Put_client client;

int main(int count, char **words)
{
    shm_put_msgs_Put_Request request = {0}, taken;
    shm_put_msgs_Put_Reply reply = {0};
    char long_name[300] = "/";
    int wrong = count != 2;
    MUST(shm_put_msgs_Put_server_open(&server, words[1], NULL), SHMGEN_OK);
    MUST(shm_put_msgs_Put_client_open(&client, words[1], NULL), SHMGEN_OK);
    request.codes_count = 9;
    MUST(shm_put_msgs_Put_client_send(&client, &request), SHMGEN_COUNT_EXCEEDED);
    MUST(strcmp(shmgen_path_text(&client.end.requests.path), "codes"), 0);

    /* A client that is faulty hears at once that its call failed. */
    MUST(shmgen_publisher_write(&client.end.requests, &request, sizeof request, 0), SHMGEN_OK);
    client.end.number = client.end.requests.sequence;
    MUST(shm_put_msgs_Put_server_take(&server, &taken, 0), SHMGEN_NOTHING_NEW);
    MUST(shm_put_msgs_Put_client_poll(&client, &reply), SHMGEN_CALL_FAILED);

    /* A response that does not fit leaves the call waiting; what a faulty server sends ends it. */
    request.codes_count = 1;
    MUST(shm_put_msgs_Put_client_send(&client, &request), SHMGEN_OK);
    MUST(shm_put_msgs_Put_server_take(&server, &taken, 0), SHMGEN_OK);
    reply.response.codes_count = 9;
    MUST(shm_put_msgs_Put_server_reply(&server, &reply, 0), SHMGEN_COUNT_EXCEEDED);
    MUST(shm_put_msgs_Put_client_poll(&client, &reply), SHMGEN_NOTHING_NEW);
    reply.call = server.end.number;
    reply.response.codes_count = 9;
    MUST(shmgen_publisher_write(&server.end.responses, &reply, sizeof reply, 0), SHMGEN_OK);
    MUST(shm_put_msgs_Put_client_poll(&client, &reply), SHMGEN_COUNT_EXCEEDED);
    MUST(shm_put_msgs_Put_client_poll(&client, &reply), SHMGEN_NOTHING_NEW);
    MUST(shm_put_msgs_Put_server_fail(&server, 0), SHMGEN_OK);
    MUST(shm_put_msgs_Put_server_fail(&server, 0), SHMGEN_CALL_OVER);

    shm_put_msgs_Put_client_close(&client);
    shm_put_msgs_Put_server_close(&server);
    shm_put_msgs_Put_server_close(&server);
    MUST(shm_put_msgs_Put_client_call(&client, &request, &reply, SHMGEN_MS), SHMGEN_CLOSED);
    MUST(shm_put_msgs_Put_server_take(&server, &taken, SHMGEN_MS), SHMGEN_CLOSED);
    memset(long_name + 1, 'a', sizeof long_name - 2);
    MUST(shm_put_msgs_Put_client_open(&client, long_name, NULL), SHMGEN_TOPIC_TOO_LONG);
    MUST(shm_put_msgs_Put_server_open(&server, "", NULL), SHMGEN_TOPIC_EMPTY);
    MUST(shm_put_msgs_Put_server_start(&server, "//no", NULL), SHMGEN_TOPIC_INVALID);
    MUST(shmgen_server_step(&server.end), SHMGEN_TOPIC_INVALID);
    return wrong;
}
