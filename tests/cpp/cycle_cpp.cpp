// The calls of one cycle of a C++ program. tests/test_never_waits.py counts the instructions of each call.
#include "shm_plc_demo/demo_msgs/msg/demo.hpp"

#include <optional>

using namespace shm_plc_demo::demo_msgs::msg;

static std::optional<DemoPublisher> publisher;
static std::optional<DemoSubscriber> subscriber;
static Demo message, invalid_message;

extern "C" {
extern shmgen_status last_status;

void cpp_open(const char *topic)
{
    publisher.emplace(topic);
    subscriber.emplace(topic);
    invalid_message.label = std::string_view("longer than its bound");
    last_status = SHMGEN_OK;
}

void cpp_close()
{
    publisher.reset();
    subscriber.reset();
}

void cpp_set_message(std::uint32_t number) { message.a = number, message.b = 2 * number; }
void cpp_try_publish() { last_status = publisher->try_publish(message).code(); }
void cpp_misfit() { last_status = publisher->try_publish(invalid_message).code(); }
void cpp_heartbeat() { last_status = publisher->heartbeat().code(); }
void cpp_try_read() { last_status = subscriber->try_read() ? SHMGEN_OK : SHMGEN_NOTHING_NEW; }
void cpp_is_stale() { last_status = subscriber->is_stale(std::chrono::milliseconds(1)) ? SHMGEN_OK : SHMGEN_NOTHING_NEW; }
}
