/* One cycle of a C program, call by call. */
#include "shm_plc_demo/demo_msgs/msg/demo_shm.h"
#include "shm_plc_demo/demo_msgs/srv/ask_service.h"

static shm_demo_msgs_Demo_publisher publisher;
static shm_demo_msgs_Demo_subscriber subscriber;
static shm_demo_msgs_Ask_client client;
static shm_demo_msgs_Ask_server server;
static shm_demo_msgs_Demo message, misfit, heard;
static shm_demo_msgs_Ask_Request request;
static shm_demo_msgs_Ask_Reply reply;
shmgen_status said;

void c_open(const char *topic)
{
    said = shm_demo_msgs_Demo_publisher_open(&publisher, topic, NULL);
    if (said == SHMGEN_OK)
        said = shm_demo_msgs_Demo_subscriber_open(&subscriber, topic, NULL);
    if (said == SHMGEN_OK)
        said = shm_demo_msgs_Ask_server_open(&server, topic, NULL);
    if (said == SHMGEN_OK)
        said = shm_demo_msgs_Ask_client_open(&client, topic, NULL);
    misfit.tail_count = 99;
}

void c_close(void)
{
    shm_demo_msgs_Demo_publisher_close(&publisher);
    shm_demo_msgs_Demo_subscriber_close(&subscriber);
    shm_demo_msgs_Ask_client_close(&client);
    shm_demo_msgs_Ask_server_close(&server);
}

void c_say(uint32_t number) { message.a = number, message.b = 2 * number; }
void c_try_publish(void) { said = shm_demo_msgs_Demo_publisher_try_publish(&publisher, &message); }
void c_misfit(void) { said = shm_demo_msgs_Demo_publisher_try_publish(&publisher, &misfit); }
void c_heartbeat(void) { said = shmgen_publisher_heartbeat(&publisher.end); }
void c_try_read(void) { said = shm_demo_msgs_Demo_subscriber_try_read(&subscriber, &heard); }
void c_is_stale(void) { said = (shmgen_status)shmgen_subscriber_is_stale(&subscriber.end, SHMGEN_MS); }
void c_send(void) { said = shm_demo_msgs_Ask_client_send(&client, &request); }
void c_poll(void) { said = shm_demo_msgs_Ask_client_poll(&client, &reply); }
void c_take(void) { said = shm_demo_msgs_Ask_server_take(&server, &request, 0); }
void c_reply(void) { said = shm_demo_msgs_Ask_server_reply(&server, &reply, 0); }
