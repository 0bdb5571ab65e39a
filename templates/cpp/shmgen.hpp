// Publishers and subscribers of messages in C++17. Opening throws; nothing in the cycle does, waits without a limit, or
// takes memory.
//
// Made by shmgen; changes made here are lost.
#ifndef SHMGEN_HPP
#define SHMGEN_HPP

#include "shmgen_values.hpp"

#include <optional>
#include <stdexcept>
#include <utility>
#include <vector>

namespace shmgen {

// depth, mode, group, lock_us: see shmgen_link.h. All 0 is what is usual.
using Options = shmgen_options;

inline const char *text_of(Status status) noexcept { return shmgen_status_text(status); }

// Why a topic, service or action could not be opened.
class Error : public std::runtime_error {
public:
    Error(const std::string &name, Status status) : std::runtime_error(name + ": " + text_of(status)), status_(status) {}
    Status status() const noexcept { return status_; }

private:
    Status status_;
};

// A time as the C calls take it; what is longer than a century is a century.
template <class Rep, class Period> std::int64_t ns_of(std::chrono::duration<Rep, Period> time) noexcept
{
    const std::chrono::duration<double> seconds = time;
    return seconds.count() > 3e9 ? INT64_C(3000000000000000000)
                                 : static_cast<std::int64_t>(std::chrono::duration_cast<std::chrono::nanoseconds>(time).count());
}

// The one writer of a topic. For one thread at a time; a forked child opens its own.
template <class T> class Publisher {
    static_assert(std::is_trivially_copyable<T>::value && std::is_standard_layout<T>::value, "messages are bytes");

public:
    // Not open: see open() and start().
    Publisher() noexcept = default;
#if defined(__cpp_exceptions)
    // Opens the topic's region or makes it, and claims it, which takes a second where a PLC was the writer before.
    // Throws Error.
    explicit Publisher(const std::string &topic, const Options &options = {})
    {
        const Status status = open(topic.c_str(), options);
        if (status != SHMGEN_OK)
            throw Error(topic, status);
    }
#endif
    Publisher(const Publisher &) = delete;
    Publisher &operator=(const Publisher &) = delete;
    Publisher(Publisher &&other) noexcept : end_(std::exchange(other.end_, shmgen_publisher())) {}
    Publisher &operator=(Publisher &&other) noexcept
    {
        if (this != &other) {
            close();
            end_ = std::exchange(other.end_, shmgen_publisher());
        }
        return *this;
    }
    ~Publisher() { close(); }

    // The same without exceptions.
    [[nodiscard]] Status open(const char *topic, const Options &options = {}) noexcept
    {
        close();
        const shmgen_type type = Message<T>::type();
        return shmgen_publisher_open(&end_, topic, &type, &options);
    }
    // The same without waiting: call step() in each cycle until it says SHMGEN_OK.
    Status start(const char *topic, const Options &options = {}) noexcept
    {
        close();
        const shmgen_type type = Message<T>::type();
        return shmgen_publisher_start(&end_, topic, &type, &options);
    }
    Status step() noexcept { return shmgen_publisher_step(&end_); }
    // Others may claim the topic then; the region stays.
    void close() noexcept { shmgen_publisher_close(&end_); }
    bool is_open() const noexcept { return end_.end.step == SHMGEN_STEP_READY; }

    // Waits for the lock as long as the options say. What does not fit is refused: rejected() names the field, and the
    // region keeps the former sample. SHMGEN_CLAIM_LOST: another writer has taken the topic over.
    [[nodiscard]] Status publish(const T &message) noexcept { return send(message, end_.end.limit); }
    // Never waits, and where all is well makes no system call.
    [[nodiscard]] Status try_publish(const T &message) noexcept { return send(message, 0); }
    // Tells readers that the writer lives, without a sample.
    Status heartbeat() noexcept { return shmgen_publisher_heartbeat(&end_); }

    // The field that did not fit in the last message published, `points[3].label`; empty if all did.
    std::string_view rejected() const noexcept { return shmgen_path_text(&end_.path); }
    // Number of the newest sample, 0 = none yet.
    std::uint32_t sequence() const noexcept { return end_.sequence; }
    // How often the lock was not free in time, and how many messages did not fit.
    std::uint32_t lock_misses() const noexcept { return end_.end.misses; }
    std::uint32_t refused() const noexcept { return end_.end.refused; }
    shmgen_publisher &c() noexcept { return end_; }

private:
    Status send(const T &message, std::int64_t limit) noexcept
    {
        shmgen_path_clear(&end_.path);
        const Status status = Message<T>::template misfit<true>(message, end_.path);
        if (status != SHMGEN_OK) {
            end_.end.refused++;
            return status;
        }
        return shmgen_publisher_write(&end_, &message, sizeof message, limit);
    }

    shmgen_publisher end_{};
};

// A reader of a topic. For one thread at a time; a forked child opens its own.
template <class T> class Subscriber {
    static_assert(std::is_trivially_copyable<T>::value && std::is_standard_layout<T>::value, "messages are bytes");

public:
    // Not open: see open() and start().
    Subscriber() noexcept = default;
#if defined(__cpp_exceptions)
    // Opens the topic's region, or makes it when the writer comes later. Throws Error.
    explicit Subscriber(const std::string &topic, const Options &options = {})
    {
        const Status status = open(topic.c_str(), options);
        if (status != SHMGEN_OK)
            throw Error(topic, status);
    }
#endif
    Subscriber(const Subscriber &) = delete;
    Subscriber &operator=(const Subscriber &) = delete;
    Subscriber(Subscriber &&other) noexcept
        : end_(std::exchange(other.end_, shmgen_subscriber())), status_(other.status_)
    {
    }
    Subscriber &operator=(Subscriber &&other) noexcept
    {
        if (this != &other) {
            close();
            end_ = std::exchange(other.end_, shmgen_subscriber());
            status_ = other.status_;
        }
        return *this;
    }
    ~Subscriber() { close(); }

    [[nodiscard]] Status open(const char *topic, const Options &options = {}) noexcept
    {
        close();
        const shmgen_type type = Message<T>::type();
        return shmgen_subscriber_open(&end_, topic, &type, &options);
    }
    Status start(const char *topic, const Options &options = {}) noexcept
    {
        close();
        const shmgen_type type = Message<T>::type();
        return shmgen_subscriber_start(&end_, topic, &type, &options);
    }
    Status step() noexcept { return shmgen_subscriber_step(&end_); }
    void close() noexcept { shmgen_subscriber_close(&end_); }
    bool is_open() const noexcept { return end_.end.step == SHMGEN_STEP_READY; }

    // The newest sample, or nothing: it has been read already, or cannot be had now; status() says which.
    std::optional<T> read() noexcept
    {
        return made([this](T &into) { return read_into(into); });
    }
    // The same, which never waits, and where all is well makes no system call.
    std::optional<T> try_read() noexcept
    {
        return made([this](T &into) { return status_ = shmgen_subscriber_read(&end_, &into, sizeof into, 0, receive); });
    }
    // The oldest unread sample that is still there.
    std::optional<T> read_next() noexcept
    {
        return made([this](T &into) { return next_into(into); });
    }
    // The newest sample as soon as there is a new one, or nothing after that time.
    template <class Rep, class Period> std::optional<T> wait(std::chrono::duration<Rep, Period> timeout) noexcept
    {
        return made([&](T &into) {
            return status_ = shmgen_subscriber_wait(&end_, &into, sizeof into, ns_of(timeout), receive);
        });
    }
    // As read(), into a message that is there: for large ones. Other than SHMGEN_OK: it is as it was, or of more than
    // SHMGEN_SMALL bytes perhaps 0.
    Status read_into(T &into) noexcept
    {
        return status_ = shmgen_subscriber_read(&end_, &into, sizeof into, end_.end.limit, receive);
    }
    Status next_into(T &into) noexcept
    {
        return status_ = shmgen_subscriber_read_next(&end_, &into, sizeof into, end_.end.limit, receive);
    }
    // Hands every unread sample that is still there to `each`, the oldest first, and returns how many.
    template <class Each> std::size_t read_all(Each &&each)
    {
        std::size_t count = 0;
        const std::uint32_t most = end_.end.slots;
        while (count < most) {
            const std::optional<T> found = read_next();
            if (!found && status_ != SHMGEN_COUNT_EXCEEDED)
                break;
            ++count;
            if (found)
                each(*found);
        }
        return count;
    }
    // The same as a vector, which takes memory.
    std::vector<T> read_all()
    {
        std::vector<T> samples;
        read_all([&](const T &sample) { samples.push_back(sample); });
        return samples;
    }
    // Whether there is an unread sample, as soon as there is one or after that time; reads nothing.
    template <class Rep, class Period> bool ready(std::chrono::duration<Rep, Period> timeout) noexcept
    {
        status_ = shmgen_subscriber_ready(&end_, ns_of(timeout));
        return status_ == SHMGEN_OK;
    }
    // What is there counts as read.
    void skip() noexcept { shmgen_subscriber_skip(&end_); }

    // Whether the writer's heartbeat has stood still for so long, as seen by calls of this: call it in each cycle.
    template <class Rep, class Period> bool is_stale(std::chrono::duration<Rep, Period> timeout) noexcept
    {
        return shmgen_subscriber_is_stale(&end_, ns_of(timeout));
    }
    // Samples that came and went unread.
    std::uint32_t missed() const noexcept { return end_.missed; }
    // Number of the newest sample read, 0 = none yet.
    std::uint32_t sequence() const noexcept { return end_.sequence; }
    // Since the newest sample read was written, by the wall clock.
    std::optional<std::chrono::nanoseconds> age() const noexcept
    {
        if (end_.stamp == 0)
            return std::nullopt;
        return std::chrono::nanoseconds(shmgen_subscriber_age(&end_));
    }
    // How the last read ended, and the field whose count was above its bound.
    Status status() const noexcept { return status_; }
    std::string_view rejected() const noexcept { return shmgen_path_text(&end_.path); }
    // How often the lock was not free in time, and how many samples had a count above its bound.
    std::uint32_t lock_misses() const noexcept { return end_.end.misses; }
    std::uint32_t refused() const noexcept { return end_.end.refused; }
    shmgen_subscriber &c() noexcept { return end_; }

private:
    static Status receive(void *copy, shmgen_path *path) noexcept
    {
        return Message<T>::template misfit<false>(*static_cast<const T *>(copy), *path);
    }
    template <class Read> static std::optional<T> made(Read &&read) noexcept
    {
        std::optional<T> found(std::in_place);
        if (read(*found) != SHMGEN_OK)
            found.reset();
        return found;
    }

    shmgen_subscriber end_{};
    Status status_{SHMGEN_CLOSED};
};

} // namespace shmgen

#endif
