/* All calls of a client and a server, from each state: of a service, and of an action whose messages are the service's Reply. */
#include "environment.h"

static shmgen_client client;
static shmgen_server server;
static shm_std_srvs_SetBool_Reply request, reply;

static shmgen_interface make_interface(bool is_action)
{
    shmgen_interface interface = shmgen_interface_of_shm_std_srvs_SetBool();
    if (is_action)
        interface.request = interface.progress = interface.response;
    return interface;
}

static void call_client(bool is_action)
{
    memset(&client, 0, sizeof client);
    client.carries = make_interface(is_action);
    set_open_state(&client.requests.end, client.carries.request.type, &semaphores[0]);
    set_open_state(&client.responses.end, client.carries.response.type, &semaphores[1]);
    set_open_state(&client.progress.end, client.carries.response.type, &semaphores[1]);
    client.requests.sequence = any;
    client.requests.turn = any;
    client.responses.last = any;
    client.number = client.goal = any;
    client.looked = any_between(0, CLOCK_LIMIT_S * 1000 * SHMGEN_MS);
    make_unknown(&request, sizeof request);
    if (any_bool())
        shmgen_client_send(&client, &request, any_timeout());
    else if (any_bool())
        shmgen_client_poll(&client, &reply, sizeof reply, any_timeout());
    else if (any_bool())
        shmgen_client_cancel(&client, any_timeout());
    else if (any_bool())
        shmgen_client_progress(&client, &reply, sizeof reply, any_timeout());
    else
        shmgen_client_sees_server(&client);
}

static void call_server(bool is_action)
{
    memset(&server, 0, sizeof server);
    server.carries = make_interface(is_action);
    set_open_state(&server.requests.end, server.carries.request.type, &semaphores[0]);
    set_open_state(&server.responses.end, server.carries.response.type, &semaphores[1]);
    set_open_state(&server.progress.end, server.carries.response.type, &semaphores[1]);
    server.responses.sequence = any;
    server.responses.turn = any;
    server.requests.last = any;
    server.number = any;
    server.awaited = any;
    make_unknown(&reply, sizeof reply);
    if (any_bool())
        shmgen_server_begin(&server, &request, server.carries.request.type.size, any_timeout());
    else if (any_bool())
        shmgen_server_end(&server, (int8_t)any, any_bool() ? &reply : NULL, any_timeout());
    else if (any_bool())
        shmgen_server_feedback(&server, &reply, any_timeout());
    else
        shmgen_server_is_cancel_requested(&server, any_timeout());
}

int main(void)
{
    for (int is_action = 0; is_action < 2; is_action++) {
        call_client(is_action != 0);
        call_server(is_action != 0);
    }
}
