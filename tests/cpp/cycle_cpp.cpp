// One cycle of a C++ program, call by call.
#include "shm_plc_demo/demo_msgs/msg/demo.hpp"

#include <optional>

using namespace shm_plc_demo::demo_msgs::msg;

static std::optional<DemoPublisher> publisher;
static std::optional<DemoSubscriber> subscriber;
static Demo message, misfit;

extern "C" {
extern shmgen_status said;

void cpp_open(const char *topic)
{
    publisher.emplace(topic);
    subscriber.emplace(topic);
    misfit.label = std::string_view("much too long for it");
    said = SHMGEN_OK;
}

void cpp_close()
{
    publisher.reset();
    subscriber.reset();
}

void cpp_say(std::uint32_t number) { message.a = number, message.b = 2 * number; }
void cpp_try_publish() { said = publisher->try_publish(message).code(); }
void cpp_misfit() { said = publisher->try_publish(misfit).code(); }
void cpp_heartbeat() { said = publisher->heartbeat().code(); }
void cpp_try_read() { said = subscriber->try_read() ? SHMGEN_OK : SHMGEN_NOTHING_NEW; }
void cpp_is_stale() { said = subscriber->is_stale(std::chrono::milliseconds(1)) ? SHMGEN_OK : SHMGEN_NOTHING_NEW; }
}
