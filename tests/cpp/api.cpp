// What C++ offers over C, in one process: prints the lines that do not hold.
//
//   api TOPIC
#include "shm_ends/ends_msgs/msg/all.hpp"
#include "shm_ends/shmgen_notifier.hpp"

#include <cstdio>
#include <filesystem>
#include <poll.h>
#include <sstream>
#include <string>
#include <sys/wait.h>
#include <thread>
#include <unistd.h>

using namespace std::chrono_literals;
using shm_ends::ends_msgs::msg::All;
using shm_ends::ends_msgs::msg::AllPublisher;
using shm_ends::ends_msgs::msg::AllSubscriber;

namespace {

int wrong = 0;

#define HOLDS(condition) ((condition) ? (void)0 : (void)(++wrong, std::printf("%d: %s\n", __LINE__, #condition)))

// The field that publish() refuses, and why.
std::string refused(AllPublisher &publisher, const All &message, shmgen::Status why)
{
    const shmgen::Status status = publisher.publish(message);
    return status == why ? std::string(publisher.rejected()) : std::string("says ") + status.text();
}

void statuses(std::string_view topic)
{
    AllPublisher publisher(topic);
    AllSubscriber subscriber(topic);
    All message;
    bool filled = false;
    if (subscriber.read_into(message))
        filled = true;
    HOLDS(!filled && subscriber.status() == SHMGEN_NOTHING_NEW);
    HOLDS(publisher.publish(message));
    if (const shmgen::Status status = subscriber.read_into(message))
        filled = status.code() == SHMGEN_OK;
    HOLDS(filled && !shmgen::Status());
    std::ostringstream out;
    out << subscriber.status() << "; " << publisher.publish(message) << "; " << shmgen::text_of(SHMGEN_CLOSED);
    HOLDS(out.str() == "done; done; not open");
}

void values_are_checked(std::string_view topic)
{
    AllPublisher publisher(topic);
    All message;
    const std::vector<int> wide = {300, -1};
    HOLDS(!message.bytes.assign(wide));
    HOLDS(refused(publisher, message, SHMGEN_VALUE_EXCEEDED) == "bytes[0]");
    message.bytes = std::vector<int>{255, -1, 3};
    HOLDS(refused(publisher, message, SHMGEN_VALUE_EXCEEDED) == "bytes[1]");
    message.bytes = std::vector<long long>{0, 255};
    HOLDS(publisher.publish(message) && message.bytes[1] == 255);
    HOLDS(!message.bytes.push_back(256) && refused(publisher, message, SHMGEN_VALUE_EXCEEDED) == "bytes[2]");
    message.bytes = std::string("\xff");
    HOLDS(publisher.publish(message) && message.bytes[0] == 255);
    message.bytes = std::vector<std::uint8_t>(9);
    HOLDS(refused(publisher, message, SHMGEN_COUNT_EXCEEDED) == "bytes");
    message.bytes.clear();
    message.shorts = std::vector<unsigned>{1, 0xFFFFFFFF};
    HOLDS(refused(publisher, message, SHMGEN_VALUE_EXCEEDED) == "shorts[1]");
    message.shorts = std::vector<unsigned>{32767};
    message.floats = std::vector<double>{0.1, 1e300};
    HOLDS(refused(publisher, message, SHMGEN_VALUE_EXCEEDED) == "floats[1]");
    message.floats = std::vector<double>{0.1, std::numeric_limits<double>::infinity()};
    HOLDS(publisher.publish(message) && message.floats[0] == 0.1F);
    message.parts.resize(2);
    message.parts[1].marks = std::vector<int>{1, 1000};
    HOLDS(refused(publisher, message, SHMGEN_VALUE_EXCEEDED) == "parts[1].marks[1]");
    message.parts[1].marks = {1, 2};
    message.parts[1].name = "much too long for it";
    HOLDS(refused(publisher, message, SHMGEN_TEXT_TOO_LONG) == "parts[1].name");
    HOLDS(publisher.refused() == 8);
}

void strings_may_overlap()
{
    All message;
    message.text = "abcdefgh";
    message.text = message.text.view().substr(1);
    HOLDS(message.text == "bcdefgh");
    message.wide = u"abcdefgh";
    message.wide = message.wide.view().substr(1);
    HOLDS(message.wide == u"bcdefgh");
}

void times_are_of_any_unit(std::string_view topic)
{
    AllPublisher publisher(topic);
    AllSubscriber subscriber(topic);
    All message;
    message.stamp = std::chrono::duration<double>(1.5);
    HOLDS(message.stamp.time() == 1500ms);
    message.stamp = 2h;
    const auto now = std::chrono::system_clock::now();
    message.span = now;
    HOLDS(message.stamp.time() == 7200s && message.span.time() == now.time_since_epoch());
    message.span = std::chrono::hours(24 * 365 * 200); // 2169
    HOLDS(refused(publisher, message, SHMGEN_VALUE_EXCEEDED) == "span");
    message.span = -1ns;
    HOLDS(publisher.publish_within(message, std::chrono::duration<double>(0.25)) && message.span.time() == -1ns);
    HOLDS(subscriber.wait(std::chrono::hours::max()) && !subscriber.wait(std::chrono::duration<float>(0.001F)));
    HOLDS(!subscriber.ready(-1h) && !subscriber.is_stale(24h));
}

void options_have_types(std::string_view topic)
{
    shmgen::Options options;
    options.mode = 0640;
    options.lock = 2ms;
    HOLDS(options.c().mode == 0640 && options.c().lock_us == 2000 && options.c().depth == 0);
    options.lock = 1ns;
    HOLDS(options.c().lock_us == 1);
    options.mode = std::filesystem::perms::owner_read | std::filesystem::perms::owner_write;
    HOLDS(options.c().mode == 0600);
    options.mode = 660; // not octal
    HOLDS(AllPublisher().open(topic, options) == SHMGEN_MODE_INVALID);
    options.mode = {};
    options.group = std::string("a_group_of_") + "this_name"; // which the options keep
    HOLDS(options.c().group == std::string_view("a_group_of_this_name"));
    options.group = nullptr;
    HOLDS(options.c().group == nullptr);
    options.lock = 2s;
    HOLDS(AllPublisher().open(topic, options) == SHMGEN_LIMIT_INVALID);
    options.lock = -1s;
    HOLDS(AllPublisher().open(topic, options) == SHMGEN_LIMIT_INVALID);
}

void topics_are_views(const std::string &topic)
{
    const std::string longer = topic + "/and more";
    AllPublisher publisher(std::string_view(longer).substr(0, topic.size()));
    HOLDS(AllPublisher().open(topic) == SHMGEN_WRITER_IN_USE);
    HOLDS(AllPublisher().open(std::string_view("/a\0b", 4)) == SHMGEN_TOPIC_INVALID);
    HOLDS(AllPublisher().open(std::string(5000, 'a')) == SHMGEN_TOPIC_TOO_LONG);
    try {
        AllSubscriber("/a-b");
        HOLDS(false);
    } catch (const shmgen::Error &error) {
        HOLDS(error.status() == SHMGEN_TOPIC_INVALID && std::string(error.what()).rfind("/a-b: the topic", 0) == 0);
    }
}

void messages_are_printed()
{
    All message;
    message.text = "a \"b\"\n";
    message.wide = u"\u00fc";
    message.bytes = {1, 2};
    message.flag = true;
    message.stamp = 1ms;
    message.parts.resize(1);
    message.parts[0].marks = {7};
    std::ostringstream out;
    out << message;
    const std::string expected = "{text: \"a \\\"b\\\"\\u000a\", wide: \"\\u00fc\", bytes: [1, 2], shorts: [], floats: [], "
                                 "fixed: [0, 0], flag: true, stamp: 1000000ns, span: 0ns, parts: [{name: \"\", marks: [7]}]}";
    HOLDS(out.str() == expected);
#if defined(__cpp_lib_format)
    HOLDS(std::format("{:>4}|{}|{}", shmgen::Status(SHMGEN_OK), message, message.text.view()).size() > expected.size());
    std::printf("std::format too\n");
#endif
}

void loans(std::string_view topic)
{
    AllPublisher publisher(topic);
    AllSubscriber subscriber(topic);
    {
        auto loan = publisher.loan();
        HOLDS(loan && !publisher.loan() && publisher.loan().status() == SHMGEN_MISUSED);
        loan->text = "given up";
    }
    HOLDS(!subscriber.read());
    auto loan = publisher.loan();
    *loan = All();
    loan->text = "kept";
    HOLDS(loan.publish() && !loan && loan.publish() == SHMGEN_MISUSED);
    const auto found = subscriber.read();
    HOLDS(found && found->text == "kept" && subscriber.sequence() == 1);
    auto wrong_one = publisher.loan();
    wrong_one->bytes = std::vector<int>{-1};
    HOLDS(wrong_one.publish() == SHMGEN_VALUE_EXCEEDED && publisher.rejected() == "bytes[0]" && publisher.refused() == 1);
    HOLDS(publisher.loan().status() == SHMGEN_OK && !subscriber.read());
    publisher.close();
    HOLDS(publisher.loan().publish() == SHMGEN_CLOSED);
}

void samples_are_borrowed(std::string_view topic)
{
    AllPublisher publisher(topic);
    AllSubscriber subscriber(topic);
    All message;
    HOLDS(!subscriber.borrow() && subscriber.status() == SHMGEN_NOTHING_NEW);
    message.text = "here";
    HOLDS(publisher.publish(message));
    {
        auto sample = subscriber.borrow();
        HOLDS(sample && sample->text == "here" && sample.give_back() && !sample && sample.give_back());
    }
    HOLDS(subscriber.sequence() == 1 && !subscriber.borrow());
    HOLDS(publisher.publish(message));
    auto sample = subscriber.borrow();
    HOLDS(publisher.publish(message) && publisher.publish(message));
    HOLDS(sample.give_back() == SHMGEN_OVERWRITTEN && subscriber.sequence() == 1);
    (void)subscriber.borrow(); // given back at once
    HOLDS(subscriber.sequence() == 4);
    auto damaged = publisher.loan();
    const std::uint32_t many = 99;
    std::memcpy(static_cast<void *>(&damaged->bytes), &many, sizeof many);
    HOLDS(shmgen_publisher_complete(&publisher.c()) == SHMGEN_OK);
    HOLDS(subscriber.borrow().status() == SHMGEN_COUNT_EXCEEDED && subscriber.rejected() == "bytes" && subscriber.refused() == 1);
}

void many_topics_wake_one(const std::string &topic)
{
    AllPublisher publisher(topic + "/b");
    AllSubscriber one(topic + "/a"), other(topic + "/b"), closed;
    HOLDS(shmgen::ready_any(1ms, one, other) == SHMGEN_NOTHING_NEW);
    HOLDS(publisher.publish(All()));
    HOLDS(shmgen::ready_any(std::chrono::hours::max(), one, other) && !one.read() && other.read());
    HOLDS(shmgen::ready_any(1ms, one, closed) == SHMGEN_CLOSED);
}

void a_notifier_is_for_event_loops(const std::string &topic)
{
    AllPublisher publisher(topic);
    AllSubscriber one(topic), closed;
    shmgen::Notifier notifier;
    pollfd file = {notifier.fd(), POLLIN, 0};
    HOLDS(notifier.is_open() && notifier.add(one) && notifier.add(closed) == SHMGEN_CLOSED);
    HOLDS(poll(&file, 1, 20) == 0);
    HOLDS(publisher.publish(All()) && poll(&file, 1, 5000) == 1);
    notifier.clear();
    HOLDS(one.try_read() && poll(&file, 1, 20) == 0);
    notifier.remove(one);
    HOLDS(publisher.publish(All()) && poll(&file, 1, 20) == 0);
}

void a_thread_ends_waits(const std::string &topic)
{
    AllSubscriber subscriber(topic);
    std::thread stopping([&] {
        std::this_thread::sleep_for(20ms);
        subscriber.stop();
    });
    HOLDS(!subscriber.wait(std::chrono::hours::max()) && subscriber.status() == SHMGEN_STOPPED);
    stopping.join();
    HOLDS(shmgen::ready_any(std::chrono::hours::max(), subscriber) == SHMGEN_STOPPED);
    HOLDS(subscriber.open(topic) && !subscriber.ready(1ms) && subscriber.status() == SHMGEN_NOTHING_NEW);
}

void forked_children(const std::string &topic)
{
    AllPublisher publisher(topic);
    const pid_t idle = fork();
    if (idle == 0)
        for (;;)
            pause();
    const pid_t closing = fork();
    if (closing == 0) {
        publisher.close();
        _exit(0);
    }
    HOLDS(waitpid(closing, nullptr, 0) == closing && AllPublisher().open(topic) == SHMGEN_WRITER_IN_USE);
    HOLDS(publisher.publish(All()));
    publisher.close();
    HOLDS(AllPublisher().open(topic));
    kill(idle, SIGKILL);
    HOLDS(waitpid(idle, nullptr, 0) == idle);
}

} // namespace

int main(int, char **words)
{
    const std::string topic = words[1];
    alarm(30);
    statuses(topic);
    values_are_checked(topic);
    strings_may_overlap();
    times_are_of_any_unit(topic);
    options_have_types(topic);
    topics_are_views(topic);
    messages_are_printed();
    loans(topic + "/loans");
    samples_are_borrowed(topic + "/borrowed");
    many_topics_wake_one(topic);
    a_notifier_is_for_event_loops(topic + "/notified");
    a_thread_ends_waits(topic + "/stopped");
    forked_children(topic);
    return wrong;
}
