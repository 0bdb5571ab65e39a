// Tests the parts of the C++ API that C does not have. Prints each condition that is false; the exit status is their number.
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

int failures = 0;

#define CHECK(condition) ((condition) ? (void)0 : (void)(++failures, std::printf("%d: %s\n", __LINE__, #condition)))

// Publishes a message that must be refused. Returns the path of the rejected field, or a text if the status is not `expected`.
std::string rejected_field(AllPublisher &publisher, const All &message, shmgen::Status expected)
{
    const shmgen::Status status = publisher.publish(message);
    return status == expected ? std::string(publisher.rejected()) : std::string("unexpected status: ") + status.text();
}

void test_statuses(std::string_view topic)
{
    AllPublisher publisher(topic);
    AllSubscriber subscriber(topic);
    All message;
    bool has_message = false;
    if (subscriber.read_into(message))
        has_message = true;
    CHECK(!has_message && subscriber.status() == SHMGEN_NOTHING_NEW);
    CHECK(publisher.publish(message));
    if (const shmgen::Status status = subscriber.read_into(message))
        has_message = status.code() == SHMGEN_OK;
    CHECK(has_message && !shmgen::Status());
    std::ostringstream stream;
    stream << subscriber.status() << "; " << publisher.publish(message) << "; " << shmgen::text_of(SHMGEN_CLOSED);
    CHECK(stream.str() == "done; done; not open");
}

void test_values_are_checked(std::string_view topic)
{
    AllPublisher publisher(topic);
    All message;
    const std::vector<int> wide = {300, -1};
    CHECK(!message.bytes.assign(wide));
    CHECK(rejected_field(publisher, message, SHMGEN_VALUE_EXCEEDED) == "bytes[0]");
    message.bytes = std::vector<int>{255, -1, 3};
    CHECK(rejected_field(publisher, message, SHMGEN_VALUE_EXCEEDED) == "bytes[1]");
    message.bytes = std::vector<long long>{0, 255};
    CHECK(publisher.publish(message) && message.bytes[1] == 255);
    CHECK(!message.bytes.push_back(256) && rejected_field(publisher, message, SHMGEN_VALUE_EXCEEDED) == "bytes[2]");
    message.bytes = std::string("\xff");
    CHECK(publisher.publish(message) && message.bytes[0] == 255);
    message.bytes = std::vector<std::uint8_t>(9);
    CHECK(rejected_field(publisher, message, SHMGEN_COUNT_EXCEEDED) == "bytes");
    message.bytes.clear();
    message.shorts = std::vector<unsigned>{1, 0xFFFFFFFF};
    CHECK(rejected_field(publisher, message, SHMGEN_VALUE_EXCEEDED) == "shorts[1]");
    message.shorts = std::vector<unsigned>{32767};
    message.floats = std::vector<double>{0.1, 1e300};
    CHECK(rejected_field(publisher, message, SHMGEN_VALUE_EXCEEDED) == "floats[1]");
    message.floats = std::vector<double>{0.1, std::numeric_limits<double>::infinity()};
    CHECK(publisher.publish(message) && message.floats[0] == 0.1F);
    message.parts.resize(2);
    message.parts[1].marks = std::vector<int>{1, 1000};
    CHECK(rejected_field(publisher, message, SHMGEN_VALUE_EXCEEDED) == "parts[1].marks[1]");
    message.parts[1].marks = {1, 2};
    message.parts[1].name = "longer than its bound";
    CHECK(rejected_field(publisher, message, SHMGEN_TEXT_TOO_LONG) == "parts[1].name");
    CHECK(publisher.refused() == 8);
}

void test_overlapping_strings()
{
    All message;
    message.text = "abcdefgh";
    message.text = message.text.view().substr(1);
    CHECK(message.text == "bcdefgh");
    message.wide = u"abcdefgh";
    message.wide = message.wide.view().substr(1);
    CHECK(message.wide == u"bcdefgh");
}

void test_time_units(std::string_view topic)
{
    AllPublisher publisher(topic);
    AllSubscriber subscriber(topic);
    All message;
    message.stamp = std::chrono::duration<double>(1.5);
    CHECK(message.stamp.time() == 1500ms);
    message.stamp = 2h;
    const auto now = std::chrono::system_clock::now();
    message.span = now;
    CHECK(message.stamp.time() == 7200s && message.span.time() == now.time_since_epoch());
    message.span = std::chrono::hours(24 * 365 * 200); // 2169
    CHECK(rejected_field(publisher, message, SHMGEN_VALUE_EXCEEDED) == "span");
    message.span = -1ns;
    CHECK(publisher.publish_within(message, std::chrono::duration<double>(0.25)) && message.span.time() == -1ns);
    CHECK(subscriber.wait(std::chrono::hours::max()) && !subscriber.wait(std::chrono::duration<float>(0.001F)));
    CHECK(!subscriber.ready(-1h) && !subscriber.is_stale(24h));
}

void test_options(std::string_view topic)
{
    shmgen::Options options;
    options.mode = 0640;
    options.lock = 2ms;
    CHECK(options.c().mode == 0640 && options.c().lock_us == 2000 && options.c().depth == 0);
    options.lock = 1ns;
    CHECK(options.c().lock_us == 1);
    options.mode = std::filesystem::perms::owner_read | std::filesystem::perms::owner_write;
    CHECK(options.c().mode == 0600);
    options.mode = 660; // not octal
    CHECK(AllPublisher().open(topic, options) == SHMGEN_MODE_INVALID);
    options.mode = {};
    options.group = std::string("group_name_") + "in_a_temporary"; // Options must copy the name
    CHECK(options.c().group == std::string_view("group_name_in_a_temporary"));
    options.group = nullptr;
    CHECK(options.c().group == nullptr);
    options.lock = 2s;
    CHECK(AllPublisher().open(topic, options) == SHMGEN_LIMIT_INVALID);
    options.lock = -1s;
    CHECK(AllPublisher().open(topic, options) == SHMGEN_LIMIT_INVALID);
}

void test_topics(const std::string &topic)
{
    const std::string longer_topic = topic + "/longer";
    AllPublisher publisher(std::string_view(longer_topic).substr(0, topic.size()));
    CHECK(AllPublisher().open(topic) == SHMGEN_WRITER_IN_USE);
    CHECK(AllPublisher().open(std::string_view("/a\0b", 4)) == SHMGEN_TOPIC_INVALID);
    CHECK(AllPublisher().open(std::string(5000, 'a')) == SHMGEN_TOPIC_TOO_LONG);
    try {
        AllSubscriber("/a-b");
        CHECK(false);
    } catch (const shmgen::Error &error) {
        CHECK(error.status() == SHMGEN_TOPIC_INVALID && std::string(error.what()).rfind("/a-b: the topic", 0) == 0);
    }
}

void test_printing()
{
    All message;
    message.text = "a \"b\"\n";
    message.wide = u"\u00fc";
    message.bytes = {1, 2};
    message.flag = true;
    message.stamp = 1ms;
    message.parts.resize(1);
    message.parts[0].marks = {7};
    std::ostringstream stream;
    stream << message;
    const std::string expected = "{text: \"a \\\"b\\\"\\u000a\", wide: \"\\u00fc\", bytes: [1, 2], shorts: [], floats: [], "
                                 "fixed: [0, 0], flag: true, stamp: 1000000ns, span: 0ns, parts: [{name: \"\", marks: [7]}]}";
    CHECK(stream.str() == expected);
#if defined(__cpp_lib_format)
    CHECK(std::format("{:>4}|{}|{}", shmgen::Status(SHMGEN_OK), message, message.text.view()).size() > expected.size());
    std::printf("std::format is supported\n");
#endif
}

void test_loans(std::string_view topic)
{
    AllPublisher publisher(topic);
    AllSubscriber subscriber(topic);
    {
        auto loan = publisher.loan();
        CHECK(loan && !publisher.loan() && publisher.loan().status() == SHMGEN_MISUSED);
        loan->text = "dropped";
    }
    CHECK(!subscriber.read());
    auto loan = publisher.loan();
    *loan = All();
    loan->text = "published";
    CHECK(loan.publish() && !loan && loan.publish() == SHMGEN_MISUSED);
    const auto sample = subscriber.read();
    CHECK(sample && sample->text == "published" && subscriber.sequence() == 1);
    auto invalid_loan = publisher.loan();
    invalid_loan->bytes = std::vector<int>{-1};
    CHECK(invalid_loan.publish() == SHMGEN_VALUE_EXCEEDED && publisher.rejected() == "bytes[0]" && publisher.refused() == 1);
    CHECK(publisher.loan().status() == SHMGEN_OK && !subscriber.read());
    publisher.close();
    CHECK(publisher.loan().publish() == SHMGEN_CLOSED);
}

void test_borrowed_samples(std::string_view topic)
{
    AllPublisher publisher(topic);
    AllSubscriber subscriber(topic);
    All message;
    CHECK(!subscriber.borrow() && subscriber.status() == SHMGEN_NOTHING_NEW);
    message.text = "here";
    CHECK(publisher.publish(message));
    {
        auto sample = subscriber.borrow();
        CHECK(sample && sample->text == "here" && sample.give_back() && !sample && sample.give_back());
    }
    CHECK(subscriber.sequence() == 1 && !subscriber.borrow());
    CHECK(publisher.publish(message));
    auto sample = subscriber.borrow();
    CHECK(publisher.publish(message) && publisher.publish(message));
    CHECK(sample.give_back() == SHMGEN_OVERWRITTEN && subscriber.sequence() == 1);
    (void)subscriber.borrow(); // the temporary returns the sample at once
    CHECK(subscriber.sequence() == 4);
    auto damaged_loan = publisher.loan();
    const std::uint32_t too_many = 99;
    std::memcpy(static_cast<void *>(&damaged_loan->bytes), &too_many, sizeof too_many);
    CHECK(shmgen_publisher_complete(&publisher.c()) == SHMGEN_OK);
    CHECK(subscriber.borrow().status() == SHMGEN_COUNT_EXCEEDED && subscriber.rejected() == "bytes" && subscriber.refused() == 1);
}

void test_ready_any(const std::string &topic)
{
    AllPublisher publisher(topic + "/b");
    AllSubscriber first(topic + "/a"), second(topic + "/b"), closed;
    CHECK(shmgen::ready_any(1ms, first, second) == SHMGEN_NOTHING_NEW);
    CHECK(publisher.publish(All()));
    CHECK(shmgen::ready_any(std::chrono::hours::max(), first, second) && !first.read() && second.read());
    CHECK(shmgen::ready_any(1ms, first, closed) == SHMGEN_CLOSED);
}

void test_notifier(const std::string &topic)
{
    AllPublisher publisher(topic);
    AllSubscriber subscriber(topic), closed;
    shmgen::Notifier notifier;
    pollfd poll_entry = {notifier.fd(), POLLIN, 0};
    CHECK(notifier.is_open() && notifier.add(subscriber) && notifier.add(closed) == SHMGEN_CLOSED);
    CHECK(poll(&poll_entry, 1, 20) == 0);
    CHECK(publisher.publish(All()) && poll(&poll_entry, 1, 5000) == 1);
    notifier.clear();
    CHECK(subscriber.try_read() && poll(&poll_entry, 1, 20) == 0);
    notifier.remove(subscriber);
    CHECK(publisher.publish(All()) && poll(&poll_entry, 1, 20) == 0);
}

void test_stop(const std::string &topic)
{
    AllSubscriber subscriber(topic);
    std::thread stopping_thread([&] {
        std::this_thread::sleep_for(20ms);
        subscriber.stop();
    });
    CHECK(!subscriber.wait(std::chrono::hours::max()) && subscriber.status() == SHMGEN_STOPPED);
    stopping_thread.join();
    CHECK(shmgen::ready_any(std::chrono::hours::max(), subscriber) == SHMGEN_STOPPED);
    CHECK(subscriber.open(topic) && !subscriber.ready(1ms) && subscriber.status() == SHMGEN_NOTHING_NEW);
}

void test_forked_children(const std::string &topic)
{
    AllPublisher publisher(topic);
    const pid_t idle_child = fork();
    if (idle_child == 0)
        for (;;)
            pause();
    const pid_t closing_child = fork();
    if (closing_child == 0) {
        publisher.close();
        _exit(0);
    }
    CHECK(waitpid(closing_child, nullptr, 0) == closing_child && AllPublisher().open(topic) == SHMGEN_WRITER_IN_USE);
    CHECK(publisher.publish(All()));
    publisher.close();
    CHECK(AllPublisher().open(topic));
    kill(idle_child, SIGKILL);
    CHECK(waitpid(idle_child, nullptr, 0) == idle_child);
}

} // namespace

int main(int, char **argv)
{
    const std::string topic = argv[1];
    alarm(30);
    test_statuses(topic);
    test_values_are_checked(topic);
    test_overlapping_strings();
    test_time_units(topic);
    test_options(topic);
    test_topics(topic);
    test_printing();
    test_loans(topic + "/loans");
    test_borrowed_samples(topic + "/borrowed");
    test_ready_any(topic);
    test_notifier(topic + "/notified");
    test_stop(topic + "/stopped");
    test_forked_children(topic);
    return failures;
}
