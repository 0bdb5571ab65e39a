/* A client and a server of a service, and of an action whose messages are like its Reply: each call, from each state. */
#include "anything.h"

static shmgen_client client;
static shmgen_server server;
static shm_std_srvs_SetBool_Reply request, reply;

static shmgen_interface carries(bool acts)
{
    shmgen_interface made = shmgen_interface_of_shm_std_srvs_SetBool();
    if (acts)
        made.request = made.progress = made.response;
    return made;
}

static void called(bool acts)
{
    memset(&client, 0, sizeof client);
    client.carries = carries(acts);
    opened(&client.requests.end, client.carries.request.type, &semaphores[0]);
    opened(&client.responses.end, client.carries.response.type, &semaphores[1]);
    opened(&client.progress.end, client.carries.response.type, &semaphores[1]);
    client.requests.sequence = any;
    client.requests.turn = any;
    client.responses.last = any;
    client.number = client.goal = any;
    client.looked = between(0, SHMGEN_END * 1000 * SHMGEN_MS);
    given(&request, sizeof request);
    if (some())
        shmgen_client_send(&client, &request, limit());
    else if (some())
        shmgen_client_poll(&client, &reply, sizeof reply, limit());
    else if (some())
        shmgen_client_cancel(&client, limit());
    else if (some())
        shmgen_client_progress(&client, &reply, sizeof reply, limit());
    else
        shmgen_client_sees_server(&client);
}

static void served(bool acts)
{
    memset(&server, 0, sizeof server);
    server.carries = carries(acts);
    opened(&server.requests.end, server.carries.request.type, &semaphores[0]);
    opened(&server.responses.end, server.carries.response.type, &semaphores[1]);
    opened(&server.progress.end, server.carries.response.type, &semaphores[1]);
    server.responses.sequence = any;
    server.responses.turn = any;
    server.requests.last = any;
    server.number = any;
    server.awaited = any;
    given(&reply, sizeof reply);
    if (some())
        shmgen_server_begin(&server, &request, server.carries.request.type.size, limit());
    else if (some())
        shmgen_server_end(&server, (int8_t)any, some() ? &reply : NULL, limit());
    else if (some())
        shmgen_server_feedback(&server, &reply, limit());
    else
        shmgen_server_is_cancel_requested(&server, limit());
}

int main(void)
{
    for (int acts = 0; acts < 2; acts++) {
        called(acts != 0);
        served(acts != 0);
    }
}
