/* The calls of one cycle of a C program. tests/test_never_waits.py counts the instructions of each call. */
#include "shm_plc_demo/demo_msgs/msg/demo_shm.h"
#include "shm_plc_demo/demo_msgs/srv/ask_service.h"

static shm_demo_msgs_Demo_publisher publisher;
static shm_demo_msgs_Demo_subscriber subscriber;
static shm_demo_msgs_Ask_client client;
static shm_demo_msgs_Ask_server server;
static shm_demo_msgs_Demo message, invalid_message, received;
static shm_demo_msgs_Ask_Request request;
static shm_demo_msgs_Ask_Reply reply;
shmgen_status last_status;

void c_open(const char *topic)
{
    last_status = shm_demo_msgs_Demo_publisher_open(&publisher, topic, NULL);
    if (last_status == SHMGEN_OK)
        last_status = shm_demo_msgs_Demo_subscriber_open(&subscriber, topic, NULL);
    if (last_status == SHMGEN_OK)
        last_status = shm_demo_msgs_Ask_server_open(&server, topic, NULL);
    if (last_status == SHMGEN_OK)
        last_status = shm_demo_msgs_Ask_client_open(&client, topic, NULL);
    invalid_message.tail_count = 99;
}

void c_close(void)
{
    shm_demo_msgs_Demo_publisher_close(&publisher);
    shm_demo_msgs_Demo_subscriber_close(&subscriber);
    shm_demo_msgs_Ask_client_close(&client);
    shm_demo_msgs_Ask_server_close(&server);
}

void c_set_message(uint32_t number) { message.a = number, message.b = 2 * number; }
void c_try_publish(void) { last_status = shm_demo_msgs_Demo_publisher_try_publish(&publisher, &message); }
void c_misfit(void) { last_status = shm_demo_msgs_Demo_publisher_try_publish(&publisher, &invalid_message); }
void c_heartbeat(void) { last_status = shmgen_publisher_heartbeat(&publisher.end); }
void c_try_read(void) { last_status = shm_demo_msgs_Demo_subscriber_try_read(&subscriber, &received); }
void c_is_stale(void) { last_status = (shmgen_status)shmgen_subscriber_is_stale(&subscriber.end, SHMGEN_MS); }
void c_send(void) { last_status = shm_demo_msgs_Ask_client_send(&client, &request); }
void c_poll(void) { last_status = shm_demo_msgs_Ask_client_poll(&client, &reply); }
void c_take(void) { last_status = shm_demo_msgs_Ask_server_take(&server, &request, 0); }
void c_reply(void) { last_status = shm_demo_msgs_Ask_server_reply(&server, &reply, 0); }
