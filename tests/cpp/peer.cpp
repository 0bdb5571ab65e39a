// A peer in C or C++ that does what it is told, a line at a time on stdin, and answers each with a line.
//
//   open NAME c|cpp pub|sub TOPIC [depth=N] [mode=OCTAL] [group=NAME] [lock_us=N] [start=1] [passive=1]
//   step NAME, publish NAME A, try_publish NAME A, misfit NAME count|text, begin NAME A, complete NAME, heartbeat NAME
//   read|try|next|wait NAME [MS], all NAME, ready NAME MS, stale NAME MS, skip NAME, figures NAME, close NAME, sleep MS, fork NAME, child NAME 0|1
//
// An answer is `0 ...`, or the number of a status and its text.
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

struct Value {
    std::uint32_t a, b;
    std::string label;
    std::vector<std::int32_t> tail;
};

// Either language behind one face.
struct End {
    virtual ~End() = default;
    virtual shmgen_status open(const std::string &topic, bool writes, const shmgen::Options &options, bool waits) = 0;
    virtual shmgen_status step() = 0;
    virtual shmgen_status publish(std::uint32_t a, bool waits) = 0;
    virtual shmgen_status misfit(const std::string &what) = 0;
    virtual shmgen_status read(const std::string &how, milliseconds time, Value &value) = 0;
    virtual shmgen_publisher &publisher() = 0;
    virtual shmgen_subscriber &subscriber() = 0;
};

struct InC : End {
    c_end end{};
    ~InC() override { c_close(&end); }
    shmgen_status open(const std::string &topic, bool writes, const shmgen::Options &options, bool waits) override
    {
        shmgen_options wanted = options.c();
        wanted.reopen = 0; // as in C by default
        return c_open(&end, topic.c_str(), writes, &wanted, waits);
    }
    shmgen_status step() override { return c_step(&end); }
    shmgen_status publish(std::uint32_t a, bool waits) override { return c_publish(&end, a, waits); }
    shmgen_status misfit(const std::string &what) override { return c_publish_misfit(&end, what.c_str()); }
    shmgen_status read(const std::string &how, milliseconds time, Value &value) override
    {
        shm_demo_msgs_Demo found;
        const shmgen_status status = c_read(&end, how.c_str(), shmgen::ns_of(time), &found);
        if (status == SHMGEN_OK) {
            value = {found.a, found.b, found.label, {}};
            for (std::uint32_t index = 0; index < found.tail_count; ++index)
                value.tail.push_back(found.tail[index]);
        }
        return status;
    }
    shmgen_publisher &publisher() override { return end.publisher.end; }
    shmgen_subscriber &subscriber() override { return end.subscriber.end; }
};

// As C, but without a lock.
struct InSequence : InC {
    shmgen_status open(const std::string &topic, bool writes, const shmgen::Options &options, bool) override
    {
        const shmgen_options wanted = options.c();
        shmgen_type type = shmgen_type_of_shm_demo_msgs_Demo();
        type.sequence = 1;
        end.writes = writes;
        return writes ? shmgen_publisher_open(&end.publisher.end, topic.c_str(), &type, &wanted)
                      : shmgen_subscriber_open(&end.subscriber.end, topic.c_str(), &type, &wanted);
    }
};

struct InCpp : End {
    DemoPublisher pub;
    DemoSubscriber sub;
    bool writes = false;
    shmgen_status open(const std::string &topic, bool writing, const shmgen::Options &options, bool waits) override
    try {
        writes = writing;
        if (!waits)
            return (writes ? pub.start(topic, options) : sub.start(topic, options)).code();
        if (writes)
            pub = DemoPublisher(topic, options);
        else
            sub = DemoSubscriber(topic, options);
        return SHMGEN_OK;
    } catch (const shmgen::Error &error) {
        return error.status().code();
    }
    shmgen_status step() override { return (writes ? pub.step() : sub.step()).code(); }
    static Demo made(std::uint32_t a)
    {
        Demo message;
        message.a = a;
        message.b = 2 * a;
        message.label = "x" + std::to_string(a % 1000);
        message.tail = {static_cast<std::int32_t>(a), -static_cast<std::int32_t>(a)};
        return message;
    }
    shmgen_status publish(std::uint32_t a, bool waits) override
    {
        return (waits ? pub.publish(made(a)) : pub.try_publish(made(a))).code();
    }
    shmgen_status misfit(const std::string &what) override
    {
        Demo message = made(999);
        if (what == "count")
            message.tail = std::vector<int>(4);
        else
            message.label = what == "nul" ? std::string(3, '\0') : std::string(10, 'y');
        return pub.publish(message).code();
    }
    shmgen_status read(const std::string &how, milliseconds time, Value &value) override
    {
        const std::optional<Demo> found = how == "next"   ? sub.read_next()
                                          : how == "wait" ? sub.wait(time)
                                          : how == "try"  ? sub.try_read()
                                                          : sub.read();
        if (found)
            value = {found->a, found->b, found->label.str(), {found->tail.begin(), found->tail.end()}};
        return found ? SHMGEN_OK : sub.status().code();
    }
    shmgen_publisher &publisher() override { return pub.c(); }
    shmgen_subscriber &subscriber() override { return sub.c(); }
};

std::string said(shmgen_status status) { return std::to_string(status) + " " + shmgen_status_text(status); }

std::string said(const Value &value)
{
    std::string text = std::to_string(value.a) + " " + std::to_string(value.b) + " " + value.label;
    for (const std::int32_t element : value.tail)
        text += " " + std::to_string(element);
    return text;
}

std::string opened(std::unique_ptr<End> &end, std::istringstream &words)
{
    std::string language, role, topic, word;
    words >> language >> role >> topic;
    shmgen::Options options;
    std::string group;
    bool waits = true, ends_sequence = false;
    while (words >> word) {
        const std::string key = word.substr(0, word.find('=')), value = word.substr(word.find('=') + 1);
        if (key == "group")
            group = value;
        else if (key == "start")
            waits = false;
        else if (key == "sequence")
            ends_sequence = true;
        else if (key == "mode")
            options.mode = static_cast<std::uint32_t>(std::stoul(value, nullptr, 8));
        else if (key == "lock_us")
            options.lock = std::chrono::microseconds(std::stol(value));
        else if (key == "depth")
            options.depth = static_cast<std::uint32_t>(std::stoul(value));
        else
            (key == "passive" ? options.passive : options.unstamped) = true;
    }
    if (ends_sequence)
        language = "sequence";
    options.group = group;
    if (language == "sequence")
        end = std::make_unique<InSequence>();
    else if (language == "c")
        end = std::make_unique<InC>();
    else
        end = std::make_unique<InCpp>();
    return said(end->open(topic, role == "pub", options, waits));
}

std::string answer(std::map<std::string, std::unique_ptr<End>> &ends, const std::string &line)
{
    std::istringstream words(line);
    std::string verb, name, what;
    long number = 0;
    words >> verb >> name;
    if (verb == "open")
        return opened(ends[name], words);
    if (verb == "sleep") {
        shmgen_pause(std::atol(name.c_str()) * SHMGEN_MS);
        return "0";
    }
    if (verb == "close") {
        ends.erase(name);
        return "0";
    }
    End &end = *ends.at(name);
    if (verb == "misfit") {
        words >> what;
        const shmgen_status status = end.misfit(what);
        return std::to_string(status) + " " + shmgen_path_text(&end.publisher().path) + " " +
               std::to_string(end.publisher().end.refused);
    }
    words >> number;
    const std::int64_t ns = number * SHMGEN_MS;
    if (verb == "step")
        return said(end.step());
    if (verb == "publish" || verb == "try_publish")
        return said(end.publish(static_cast<std::uint32_t>(number), verb == "publish"));
    if (verb == "begin") { // and half of it
        void *payload = nullptr;
        const shmgen_status status = shmgen_publisher_begin(&end.publisher(), end.publisher().end.limit, &payload);
        if (status == SHMGEN_OK) {
            const auto a = static_cast<std::uint32_t>(number);
            std::memcpy(payload, &a, sizeof a);
        }
        return said(status);
    }
    if (verb == "complete")
        return said(shmgen_publisher_complete(&end.publisher()));
    if (verb == "heartbeat")
        return said(shmgen_publisher_heartbeat(&end.publisher()));
    if (verb == "number")
        return std::to_string(end.publisher().sequence);
    if (verb == "ready")
        return said(shmgen_subscriber_ready(&end.subscriber(), ns));
    if (verb == "stale")
        return std::to_string(shmgen_subscriber_is_stale(&end.subscriber(), ns));
    if (verb == "skip") {
        shmgen_subscriber_skip(&end.subscriber());
        return "0";
    }
    if (verb == "fork") { // what the child hears, as writer and as reader
        const pid_t child = fork();
        if (child == 0) {
            Value value{};
            const int sent = end.publish(1, false), read = ends.at("r")->read("try", milliseconds(0), value);
            _exit(sent == SHMGEN_IN_FORKED_CHILD && read == sent && end.publish(2, true) == sent ? 0 : 1);
        }
        int status = 1;
        waitpid(child, &status, 0);
        return std::to_string(status);
    }
    if (verb == "child") { // which touches nothing, or closes what is not its own; until it is killed
        const pid_t child = fork();
        if (child == 0) {
            if (number != 0)
                shmgen_publisher_close(&end.publisher());
            std::cout << getpid() << std::endl;
            for (;;)
                pause();
        }
        return "";
    }
    if (verb == "enter") // and stays inside
        return std::to_string(shmgen_enter(&end.subscriber().end, ns > 0 ? ns : end.subscriber().end.limit));
    if (verb == "strict") { // from now on any system call but a write ends this process, by SIGKILL
        End &reader = *ends.at("r");
        Value value{};
        long wrong = 0;
        if (end.publish(0, false) != SHMGEN_OK || reader.read("try", milliseconds(0), value) != SHMGEN_OK)
            return "1"; // that checks the files, and the calls below come within the next 100 ms
        if (prctl(PR_SET_SECCOMP, SECCOMP_MODE_STRICT) != 0)
            return "1";
        for (std::uint32_t a = 1; a <= 1000; ++a)
            wrong += end.publish(a, false) != SHMGEN_OK || reader.read("try", milliseconds(0), value) != SHMGEN_OK ||
                     value.a != a;
        const char *text = wrong == 0 ? "0\n" : "1\n";
        if (write(1, text, 2) == 2)
            syscall(SYS_exit, 0);
    }
    if (verb == "figures") {
        const shmgen_subscriber &sub = end.subscriber();
        return std::to_string(sub.sequence) + " " + std::to_string(sub.missed) + " " + std::to_string(sub.end.misses) +
               " " + std::to_string(sub.end.refused) + " " + (sub.stamp != 0 ? "stamped" : "unstamped") + " " +
               shmgen_path_text(&sub.path);
    }
    Value value{};
    if (verb == "all") {
        std::string text = "0";
        while (end.read("next", milliseconds(0), value) == SHMGEN_OK)
            text += " " + std::to_string(value.a);
        return text;
    }
    const shmgen_status status = end.read(verb, milliseconds(number), value);
    return status == SHMGEN_OK ? "0 " + said(value) : said(status);
}

} // namespace

int main()
{
    std::map<std::string, std::unique_ptr<End>> ends;
    for (std::string line; std::getline(std::cin, line);)
        if (const std::string text = answer(ends, line); !text.empty())
            std::cout << text << std::endl;
    return 0;
}
