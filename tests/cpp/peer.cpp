// A peer process with endpoints in C or C++. Executes each line on stdin as a command, and prints one line as its answer.
//
// * `open NAME c|cpp pub|sub TOPIC [depth=N] [mode=OCTAL] [group=NAME] [lock_us=N] [start=1] [sequence=1] [passive=1] [unstamped=1]`
// * `step|complete|heartbeat|number|close|fork NAME`, `publish|try_publish|begin NAME A`, `misfit NAME count|text|nul`, `sleep MS`
// * `read|try|next|wait NAME [MS]`, `ready|stale|enter NAME MS`, `all|skip|figures NAME`, `child NAME 0|1`, `strict NAME`
// NAME is the endpoint's name. An answer is `0 ...`, or the number and the text of a status. Some commands answer with a number.
#include "ends.h"
#include "shm_plc_demo/demo_msgs/msg/demo.hpp"

#include <cstdlib>
#include <iostream>
#include <map>
#include <memory>
#include <sstream>

#include <linux/seccomp.h>
#include <sys/prctl.h>
#include <sys/syscall.h>
#include <sys/wait.h>

namespace {

using shm_plc_demo::demo_msgs::msg::Demo;
using shm_plc_demo::demo_msgs::msg::DemoPublisher;
using shm_plc_demo::demo_msgs::msg::DemoSubscriber;
using std::chrono::milliseconds;

struct Sample {
    std::uint32_t a, b;
    std::string label;
    std::vector<std::int32_t> tail;
};

// An endpoint in C or C++.
struct Endpoint {
    virtual ~Endpoint() = default;
    virtual shmgen_status open(const std::string &topic, bool is_writer, const shmgen::Options &options, bool is_blocking) = 0;
    virtual shmgen_status step() = 0;
    virtual shmgen_status publish(std::uint32_t a, bool is_blocking) = 0;
    virtual shmgen_status misfit(const std::string &fault) = 0;
    virtual shmgen_status read(const std::string &command, milliseconds timeout, Sample &sample) = 0;
    virtual shmgen_publisher &publisher() = 0;
    virtual shmgen_subscriber &subscriber() = 0;
};

struct CEndpoint : Endpoint {
    c_end end{};
    ~CEndpoint() override { c_close(&end); }
    shmgen_status open(const std::string &topic, bool is_writer, const shmgen::Options &options, bool is_blocking) override
    {
        shmgen_options c_options = options.c();
        c_options.reopen = 0; // the default in C
        return c_open(&end, topic.c_str(), is_writer, &c_options, is_blocking);
    }
    shmgen_status step() override { return c_step(&end); }
    shmgen_status publish(std::uint32_t a, bool is_blocking) override { return c_publish(&end, a, is_blocking); }
    shmgen_status misfit(const std::string &fault) override { return c_publish_misfit(&end, fault.c_str()); }
    shmgen_status read(const std::string &command, milliseconds timeout, Sample &sample) override
    {
        shm_demo_msgs_Demo message;
        const shmgen_status status = c_read(&end, command.c_str(), shmgen::ns_of(timeout), &message);
        if (status == SHMGEN_OK) {
            sample = {message.a, message.b, message.label, {}};
            for (std::uint32_t index = 0; index < message.tail_count; ++index)
                sample.tail.push_back(message.tail[index]);
        }
        return status;
    }
    shmgen_publisher &publisher() override { return end.publisher.end; }
    shmgen_subscriber &subscriber() override { return end.subscriber.end; }
};

// An endpoint in C that uses a sequence region, which has no lock.
struct CEndpointWithoutLock : CEndpoint {
    shmgen_status open(const std::string &topic, bool is_writer, const shmgen::Options &options, bool) override
    {
        const shmgen_options c_options = options.c();
        shmgen_type type = shmgen_type_of_shm_demo_msgs_Demo();
        type.sequence = 1;
        end.is_writer = is_writer;
        return is_writer ? shmgen_publisher_open(&end.publisher.end, topic.c_str(), &type, &c_options)
                         : shmgen_subscriber_open(&end.subscriber.end, topic.c_str(), &type, &c_options);
    }
};

struct CppEndpoint : Endpoint {
    DemoPublisher publisher_;
    DemoSubscriber subscriber_;
    bool is_writer_ = false;
    shmgen_status open(const std::string &topic, bool is_writer, const shmgen::Options &options, bool is_blocking) override
    try {
        is_writer_ = is_writer;
        if (!is_blocking)
            return (is_writer_ ? publisher_.start(topic, options) : subscriber_.start(topic, options)).code();
        if (is_writer_)
            publisher_ = DemoPublisher(topic, options);
        else
            subscriber_ = DemoSubscriber(topic, options);
        return SHMGEN_OK;
    } catch (const shmgen::Error &error) {
        return error.status().code();
    }
    shmgen_status step() override { return (is_writer_ ? publisher_.step() : subscriber_.step()).code(); }
    static Demo make_message(std::uint32_t a)
    {
        Demo message;
        message.a = a;
        message.b = 2 * a;
        message.label = "x" + std::to_string(a % 1000);
        message.tail = {static_cast<std::int32_t>(a), -static_cast<std::int32_t>(a)};
        return message;
    }
    shmgen_status publish(std::uint32_t a, bool is_blocking) override
    {
        return (is_blocking ? publisher_.publish(make_message(a)) : publisher_.try_publish(make_message(a))).code();
    }
    shmgen_status misfit(const std::string &fault) override
    {
        Demo message = make_message(999);
        if (fault == "count")
            message.tail = std::vector<int>(4);
        else
            message.label = fault == "nul" ? std::string(3, '\0') : std::string(10, 'y');
        return publisher_.publish(message).code();
    }
    shmgen_status read(const std::string &command, milliseconds timeout, Sample &sample) override
    {
        const std::optional<Demo> message = command == "next"   ? subscriber_.read_next()
                                            : command == "wait" ? subscriber_.wait(timeout)
                                            : command == "try"  ? subscriber_.try_read()
                                                                : subscriber_.read();
        if (message)
            sample = {message->a, message->b, message->label.str(), {message->tail.begin(), message->tail.end()}};
        return message ? SHMGEN_OK : subscriber_.status().code();
    }
    shmgen_publisher &publisher() override { return publisher_.c(); }
    shmgen_subscriber &subscriber() override { return subscriber_.c(); }
};

std::string text_of(shmgen_status status) { return std::to_string(status) + " " + shmgen_status_text(status); }

std::string text_of(const Sample &sample)
{
    std::string text = std::to_string(sample.a) + " " + std::to_string(sample.b) + " " + sample.label;
    for (const std::int32_t element : sample.tail)
        text += " " + std::to_string(element);
    return text;
}

std::string open_endpoint(std::unique_ptr<Endpoint> &endpoint, std::istringstream &words)
{
    std::string language, role, topic, option;
    words >> language >> role >> topic;
    shmgen::Options options;
    std::string group;
    bool is_blocking = true, without_lock = false;
    while (words >> option) {
        const std::string key = option.substr(0, option.find('=')), value = option.substr(option.find('=') + 1);
        if (key == "group")
            group = value;
        else if (key == "start")
            is_blocking = false;
        else if (key == "sequence")
            without_lock = true;
        else if (key == "mode")
            options.mode = static_cast<std::uint32_t>(std::stoul(value, nullptr, 8));
        else if (key == "lock_us")
            options.lock = std::chrono::microseconds(std::stol(value));
        else if (key == "depth")
            options.depth = static_cast<std::uint32_t>(std::stoul(value));
        else
            (key == "passive" ? options.passive : options.unstamped) = true;
    }
    if (without_lock)
        language = "sequence";
    options.group = group;
    if (language == "sequence")
        endpoint = std::make_unique<CEndpointWithoutLock>();
    else if (language == "c")
        endpoint = std::make_unique<CEndpoint>();
    else
        endpoint = std::make_unique<CppEndpoint>();
    return text_of(endpoint->open(topic, role == "pub", options, is_blocking));
}

std::string execute(std::map<std::string, std::unique_ptr<Endpoint>> &endpoints, const std::string &line)
{
    std::istringstream words(line);
    std::string command, name, fault;
    long argument = 0;
    words >> command >> name;
    if (command == "open")
        return open_endpoint(endpoints[name], words);
    if (command == "sleep") {
        shmgen_pause(std::atol(name.c_str()) * SHMGEN_MS);
        return "0";
    }
    if (command == "close") {
        endpoints.erase(name);
        return "0";
    }
    Endpoint &endpoint = *endpoints.at(name);
    if (command == "misfit") {
        words >> fault;
        const shmgen_status status = endpoint.misfit(fault);
        return std::to_string(status) + " " + shmgen_path_text(&endpoint.publisher().path) + " " +
               std::to_string(endpoint.publisher().end.refused);
    }
    words >> argument;
    const std::int64_t ns = argument * SHMGEN_MS;
    if (command == "step")
        return text_of(endpoint.step());
    if (command == "publish" || command == "try_publish")
        return text_of(endpoint.publish(static_cast<std::uint32_t>(argument), command == "publish"));
    if (command == "begin") { // writes only the first field of the sample
        void *payload = nullptr;
        const shmgen_status status = shmgen_publisher_begin(&endpoint.publisher(), endpoint.publisher().end.limit, &payload);
        if (status == SHMGEN_OK) {
            const auto a = static_cast<std::uint32_t>(argument);
            std::memcpy(payload, &a, sizeof a);
        }
        return text_of(status);
    }
    if (command == "complete")
        return text_of(shmgen_publisher_complete(&endpoint.publisher()));
    if (command == "heartbeat")
        return text_of(shmgen_publisher_heartbeat(&endpoint.publisher()));
    if (command == "number")
        return std::to_string(endpoint.publisher().sequence);
    if (command == "ready")
        return text_of(shmgen_subscriber_ready(&endpoint.subscriber(), ns));
    if (command == "stale")
        return std::to_string(shmgen_subscriber_is_stale(&endpoint.subscriber(), ns));
    if (command == "skip") {
        shmgen_subscriber_skip(&endpoint.subscriber());
        return "0";
    }
    if (command == "fork") { // a child process must not use the writer NAME and the reader `r`
        const pid_t child = fork();
        if (child == 0) {
            Sample sample{};
            const int sent = endpoint.publish(1, false), read = endpoints.at("r")->read("try", milliseconds(0), sample);
            _exit(sent == SHMGEN_IN_FORKED_CHILD && read == sent && endpoint.publish(2, true) == sent ? 0 : 1);
        }
        int status = 1;
        waitpid(child, &status, 0);
        return std::to_string(status);
    }
    if (command == "child") { // a child process that runs until it is killed, and with 1 first closes its parent's publisher
        const pid_t child = fork();
        if (child == 0) {
            if (argument != 0)
                shmgen_publisher_close(&endpoint.publisher());
            std::cout << getpid() << std::endl;
            for (;;)
                pause();
        }
        return "";
    }
    if (command == "enter") // and keeps the lock
        return std::to_string(shmgen_enter(&endpoint.subscriber().end, ns > 0 ? ns : endpoint.subscriber().end.limit));
    if (command == "strict") { // call both endpoints while seccomp kills this process at every system call except read and write
        Endpoint &reader = *endpoints.at("r");
        Sample sample{};
        long failures = 0;
        if (endpoint.publish(0, false) != SHMGEN_OK || reader.read("try", milliseconds(0), sample) != SHMGEN_OK)
            return "1"; // these calls check the region's file; the calls below need no further check within 100 ms
        if (prctl(PR_SET_SECCOMP, SECCOMP_MODE_STRICT) != 0)
            return "1";
        for (std::uint32_t a = 1; a <= 1000; ++a)
            failures += endpoint.publish(a, false) != SHMGEN_OK || reader.read("try", milliseconds(0), sample) != SHMGEN_OK ||
                        sample.a != a;
        const char *text = failures == 0 ? "0\n" : "1\n";
        if (write(1, text, 2) == 2)
            syscall(SYS_exit, 0);
    }
    if (command == "figures") {
        const shmgen_subscriber &subscriber = endpoint.subscriber();
        return std::to_string(subscriber.sequence) + " " + std::to_string(subscriber.missed) + " " +
               std::to_string(subscriber.end.misses) + " " + std::to_string(subscriber.end.refused) + " " +
               (subscriber.stamp != 0 ? "stamped" : "unstamped") + " " + shmgen_path_text(&subscriber.path);
    }
    Sample sample{};
    if (command == "all") {
        std::string text = "0";
        while (endpoint.read("next", milliseconds(0), sample) == SHMGEN_OK)
            text += " " + std::to_string(sample.a);
        return text;
    }
    const shmgen_status status = endpoint.read(command, milliseconds(argument), sample);
    return status == SHMGEN_OK ? "0 " + text_of(sample) : text_of(status);
}

} // namespace

int main()
{
    std::map<std::string, std::unique_ptr<Endpoint>> endpoints;
    for (std::string line; std::getline(std::cin, line);)
        if (const std::string text = execute(endpoints, line); !text.empty())
            std::cout << text << std::endl;
    return 0;
}
