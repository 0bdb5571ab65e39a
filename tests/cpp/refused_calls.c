/* A service's client and server in one program, with counts above their bounds, invalid names, and closed endpoints.
 * Prints the line of each call that returns a wrong status. */
#include "shm_refused/put_msgs/srv/put_service.h"

#include <stdio.h>

#define CHECK_STATUS(call, status) failures += (call) != (status) && printf("line %d\n", __LINE__)

static shm_put_msgs_Put_server server;
static shm_put_msgs_Put_client client;

int main(int argc, char **argv)
{
    shm_put_msgs_Put_Request request = {0}, received;
    shm_put_msgs_Put_Reply reply = {0};
    char long_name[300] = "/";
    int failures = argc != 2;
    CHECK_STATUS(shm_put_msgs_Put_server_open(&server, argv[1], NULL), SHMGEN_OK);
    CHECK_STATUS(shm_put_msgs_Put_client_open(&client, argv[1], NULL), SHMGEN_OK);
    request.codes_count = 9;
    CHECK_STATUS(shm_put_msgs_Put_client_send(&client, &request), SHMGEN_COUNT_EXCEEDED);
    CHECK_STATUS(strcmp(shmgen_path_text(&client.end.requests.path), "codes"), 0);

    /* If a client sends an invalid request, its call fails at once. */
    CHECK_STATUS(shmgen_publisher_write(&client.end.requests, &request, sizeof request, 0), SHMGEN_OK);
    client.end.number = client.end.requests.sequence;
    CHECK_STATUS(shm_put_msgs_Put_server_take(&server, &received, 0), SHMGEN_NOTHING_NEW);
    CHECK_STATUS(shm_put_msgs_Put_client_poll(&client, &reply), SHMGEN_CALL_FAILED);

    /* The server may retry after a refused response. An invalid response that a faulty server sends ends the call. */
    request.codes_count = 1;
    CHECK_STATUS(shm_put_msgs_Put_client_send(&client, &request), SHMGEN_OK);
    CHECK_STATUS(shm_put_msgs_Put_server_take(&server, &received, 0), SHMGEN_OK);
    reply.response.codes_count = 9;
    CHECK_STATUS(shm_put_msgs_Put_server_reply(&server, &reply, 0), SHMGEN_COUNT_EXCEEDED);
    CHECK_STATUS(shm_put_msgs_Put_client_poll(&client, &reply), SHMGEN_NOTHING_NEW);
    reply.call = server.end.number;
    reply.response.codes_count = 9;
    CHECK_STATUS(shmgen_publisher_write(&server.end.responses, &reply, sizeof reply, 0), SHMGEN_OK);
    CHECK_STATUS(shm_put_msgs_Put_client_poll(&client, &reply), SHMGEN_COUNT_EXCEEDED);
    CHECK_STATUS(shm_put_msgs_Put_client_poll(&client, &reply), SHMGEN_NOTHING_NEW);
    CHECK_STATUS(shm_put_msgs_Put_server_fail(&server, 0), SHMGEN_OK);
    CHECK_STATUS(shm_put_msgs_Put_server_fail(&server, 0), SHMGEN_CALL_OVER);

    shm_put_msgs_Put_client_close(&client);
    shm_put_msgs_Put_server_close(&server);
    shm_put_msgs_Put_server_close(&server);
    CHECK_STATUS(shm_put_msgs_Put_client_call(&client, &request, &reply, SHMGEN_MS), SHMGEN_CLOSED);
    CHECK_STATUS(shm_put_msgs_Put_server_take(&server, &received, SHMGEN_MS), SHMGEN_CLOSED);
    memset(long_name + 1, 'a', sizeof long_name - 2);
    CHECK_STATUS(shm_put_msgs_Put_client_open(&client, long_name, NULL), SHMGEN_TOPIC_TOO_LONG);
    CHECK_STATUS(shm_put_msgs_Put_server_open(&server, "", NULL), SHMGEN_TOPIC_EMPTY);
    CHECK_STATUS(shm_put_msgs_Put_server_start(&server, "//no", NULL), SHMGEN_TOPIC_INVALID);
    CHECK_STATUS(shmgen_server_step(&server.end), SHMGEN_TOPIC_INVALID);
    return failures;
}
