// Clients and servers of services in C++17 (docs/protocol.md, "Services"), and what those of actions share.
//
// Made by shmgen; changes made here are lost.
//
// A question has the number of its sample, and an answer carries the number of its question: so a late answer, to a call
// given up or to a former client, is known from its number.
#ifndef SHMGEN_CALLS_HPP
#define SHMGEN_CALLS_HPP

#include "shmgen.hpp"

#include <algorithm>

namespace shmgen {

namespace calls {

using Clock = std::chrono::steady_clock;
using Nanoseconds = std::chrono::nanoseconds;

template <class Rep, class Period> Nanoseconds time_of(std::chrono::duration<Rep, Period> time) noexcept
{
    return Nanoseconds(ns_of(time));
}

inline Nanoseconds left(Clock::time_point deadline) noexcept
{
    return std::max(Nanoseconds::zero(), std::chrono::duration_cast<Nanoseconds>(deadline - Clock::now()));
}

inline Clock::time_point deadline_of(Nanoseconds timeout) noexcept
{
    return Clock::now() + std::min(timeout, Nanoseconds(std::chrono::hours(876000)));
}

// The asking end. number() is that of the question not answered yet, 0 = none.
template <class Question, class Answer, std::uint32_t Answer::*Key> class Caller {
public:
    Status open(const std::string &questions, const std::string &answers, const Options &options) noexcept
    {
        const Status status = questions_.open(questions.c_str(), options);
        return status == SHMGEN_OK ? answers_.open(answers.c_str(), options) : status;
    }
    void close() noexcept
    {
        number_ = 0;
        questions_.close();
        answers_.close();
    }
    std::uint32_t number() const noexcept { return number_; }
    void give_up() noexcept { number_ = 0; }
    std::string_view rejected() const noexcept { return questions_.rejected(); }

    // Sends a question, and gives the one before up.
    Status ask(const Question &question) noexcept
    {
        number_ = 0;
        answers_.skip(); // what is there answers nothing that is still to come
        const Status status = questions_.publish(question);
        if (status == SHMGEN_OK)
            number_ = questions_.sequence();
        return status;
    }
    Status tell(const Question &message) noexcept { return questions_.publish(message); }
    // Answers come in the order of their questions, so the newest is enough.
    std::optional<Answer> poll() noexcept { return own(answers_.read()); }
    std::optional<Answer> wait(Nanoseconds timeout) noexcept
    {
        const Clock::time_point deadline = deadline_of(timeout);
        while (number_ != 0) {
            const Nanoseconds rest = left(deadline);
            std::optional<Answer> answer = own(answers_.wait(rest));
            if (answer || rest == Nanoseconds::zero())
                return answer;
        }
        return std::nullopt;
    }
    bool server_is_ready() noexcept
    {
        return wait_for_server(writer() == SHMGEN_PLC ? Nanoseconds(SHMGEN_CLAIM_MS * SHMGEN_MS) : Nanoseconds::zero());
    }
    bool wait_for_server(Nanoseconds timeout) noexcept
    {
        const Clock::time_point deadline = deadline_of(timeout);
        while (answers_.is_open() && !server_lives()) {
            const Nanoseconds rest = left(deadline);
            if (rest == Nanoseconds::zero())
                return false;
            shmgen_pause(std::min<std::int64_t>(2 * SHMGEN_MS, rest.count()));
        }
        return answers_.is_open();
    }

private:
    std::optional<Answer> own(std::optional<Answer> answer) noexcept
    {
        if (!answer || number_ == 0 || (*answer).*Key != number_)
            return std::nullopt;
        number_ = 0;
        return answer;
    }
    std::uint32_t writer() noexcept { return answers_.is_open() ? shmgen_load(&answers_.c().end, SHMGEN_AT(writer)) : 0; }
    // A process holds its record lock, and has put its name there; a PLC can only be seen to count.
    bool server_lives() noexcept
    {
        const shmgen_link &end = answers_.c().end;
        if (writer() != SHMGEN_PLC)
            return shmgen_byte_is_locked(&end, SHMGEN_WRITER_LOCK);
        const std::int64_t now = shmgen_now();
        const std::uint32_t beat = shmgen_load(&end, SHMGEN_AT(heartbeat));
        const bool moved = looked_ != 0 && now - looked_ < SHMGEN_CLAIM_MS * SHMGEN_MS && beat != beat_;
        beat_ = beat;
        looked_ = now;
        return moved;
    }

    Publisher<Question> questions_;
    Subscriber<Answer> answers_;
    std::int64_t looked_ = 0;
    std::uint32_t beat_ = 0;
    std::uint32_t number_ = 0;
};

// The answering end. number() is that of the question begun last: no other can be answered.
template <class Question, class Answer> class Callee {
public:
    // The questions first, and what lies there is old; then the claim that shows clients a server.
    Status open(const std::string &questions, const std::string &answers, const Options &options) noexcept
    {
        Status status = questions_.open(questions.c_str(), options);
        if (status != SHMGEN_OK)
            return status;
        questions_.skip();
        status = answers_.open(answers.c_str(), options);
        if (answers_.c().jump != 0)
            questions_.skip();
        return status;
    }
    void close() noexcept
    {
        questions_.close();
        answers_.close();
    }
    std::uint32_t number() const noexcept { return number_; }
    std::string_view rejected() const noexcept { return answers_.rejected(); }
    void skip() noexcept { questions_.skip(); }

    // The newest question, once, as soon as there is one. Tells the other side that it lives.
    Status take(Nanoseconds timeout, std::optional<Question> &question, std::uint32_t &number) noexcept
    {
        const Clock::time_point deadline = deadline_of(timeout);
        for (;;) {
            Status status = answers_.heartbeat();
            if (status != SHMGEN_OK)
                return status;
            const Nanoseconds rest = left(deadline);
            question = rest == Nanoseconds::zero() ? questions_.read()
                                            : questions_.wait(std::min(rest, Nanoseconds(SHMGEN_SIGN_MS * SHMGEN_MS)));
            if (question) {
                number = questions_.sequence();
                return shmgen_publisher_assure(&answers_.c()); // or another server has taken over, and serves it
            }
            if (rest == Nanoseconds::zero())
                return questions_.is_open() ? SHMGEN_NOTHING_NEW : SHMGEN_CLOSED;
        }
    }
    void begin(std::uint32_t number) noexcept
    {
        number_ = number;
        is_open_ = true;
    }
    bool awaits(std::uint32_t number) const noexcept { return is_open_ && number == number_; }
    // SHMGEN_CALL_OVER, and nothing sent, if that question waits no more.
    Status answer(std::uint32_t number, const Answer &answer) noexcept
    {
        if (!awaits(number))
            return SHMGEN_CALL_OVER;
        const Status status = answers_.publish(answer);
        is_open_ = status != SHMGEN_OK;
        return status;
    }

private:
    Subscriber<Question> questions_;
    Publisher<Answer> answers_;
    std::uint32_t number_ = 0;
    bool is_open_ = false;
};

} // namespace calls

// Calls one service, one call at a time. `Service` names its Request, Response and Reply.
template <class Service> class Client {
public:
    using Request = typename Service::Request;
    using Response = typename Service::Response;

    Client() noexcept = default;
#if defined(__cpp_exceptions)
    // Opens the service's regions or makes them; whether there is a server does not matter. Throws Error.
    explicit Client(const std::string &service, const Options &options = {})
    {
        const Status status = open(service, options);
        if (status != SHMGEN_OK)
            throw Error(service, status);
    }
#endif
    [[nodiscard]] Status open(const std::string &service, const Options &options = {}) noexcept
    {
        return status_ = caller_.open(service + "-request", service + "-response", options);
    }
    void close() noexcept { caller_.close(); }

    // Waits for a server, sends the request and waits for the response, all within that time. Nothing: status() is
    // SHMGEN_NO_SERVER, and nothing was sent; SHMGEN_CALL_TIMEOUT, and the server may still do it; SHMGEN_CALL_FAILED;
    // or a value did not fit, see rejected().
    template <class Rep, class Period>
    std::optional<Response> call(const Request &request, std::chrono::duration<Rep, Period> timeout) noexcept
    {
        const auto deadline = calls::deadline_of(calls::time_of(timeout));
        if (!caller_.wait_for_server(calls::left(deadline)))
            return ended(SHMGEN_NO_SERVER);
        const Status status = caller_.ask(request);
        if (status != SHMGEN_OK)
            return ended(status);
        const auto reply = caller_.wait(calls::left(deadline));
        if (!reply) {
            caller_.give_up();
            return ended(SHMGEN_CALL_TIMEOUT);
        }
        return taken(*reply);
    }
    // Sends the request, whether there is a server or not; then poll(). A call that still runs is given up.
    [[nodiscard]] Status send(const Request &request) noexcept { return status_ = caller_.ask(request); }
    // The response to what send() sent, once. Nothing: status() is SHMGEN_NOTHING_NEW or SHMGEN_CALL_FAILED.
    std::optional<Response> poll() noexcept
    {
        const auto reply = caller_.poll();
        return reply ? taken(*reply) : ended(SHMGEN_NOTHING_NEW);
    }
    // Gives up what send() sent, on this side only.
    void cancel() noexcept { caller_.give_up(); }
    // Takes up to a second where a PLC served and may have stopped.
    bool server_is_ready() noexcept { return caller_.server_is_ready(); }
    template <class Rep, class Period> bool wait_for_server(std::chrono::duration<Rep, Period> timeout) noexcept
    {
        return caller_.wait_for_server(calls::time_of(timeout));
    }
    Status status() const noexcept { return status_; }
    std::string_view rejected() const noexcept { return caller_.rejected(); }

private:
    using Reply = typename Service::Reply;
    std::optional<Response> ended(Status status) noexcept
    {
        status_ = status;
        return std::nullopt;
    }
    std::optional<Response> taken(const Reply &reply) noexcept
    {
        if (reply.status != Reply::DONE)
            return ended(SHMGEN_CALL_FAILED);
        status_ = SHMGEN_OK;
        return reply.response;
    }

    calls::Caller<Request, Reply, &Reply::call> caller_;
    Status status_ = SHMGEN_CLOSED;
};

// Serves one service, one call at a time.
template <class Service> class Server {
public:
    using Request = typename Service::Request;
    using Response = typename Service::Response;
    struct Call {
        std::uint32_t number;
        Request request;
    };

    Server() noexcept = default;
#if defined(__cpp_exceptions)
    // Opens the service's regions or makes them; a request that is there already is old. Throws Error.
    explicit Server(const std::string &service, const Options &options = {})
    {
        const Status status = open(service, options);
        if (status != SHMGEN_OK)
            throw Error(service, status);
    }
#endif
    [[nodiscard]] Status open(const std::string &service, const Options &options = {}) noexcept
    {
        return status_ = callee_.open(service + "-request", service + "-response", options);
    }
    void close() noexcept { callee_.close(); }

    // Answers each request with what handler(request) returns: a Response, or nothing for a call that failed. Ends
    // after that time, with SHMGEN_NOTHING_NEW, or where the service is lost. What the handler throws makes the call
    // FAILED and comes out here.
    template <class Handler, class Rep, class Period>
    Status serve(Handler &&handler, std::chrono::duration<Rep, Period> timeout)
    {
        const auto deadline = calls::deadline_of(calls::time_of(timeout));
        for (;;) {
            const std::optional<Call> call = wait(calls::left(deadline));
            if (!call) {
                if (status_ != SHMGEN_NOTHING_NEW || calls::left(deadline) == calls::Nanoseconds::zero())
                    return status_;
                continue;
            }
            const Failing failing{*this, *call};
            const std::optional<Response> response = handler(call->request);
            if (response)
                status_ = reply(*call, *response);
        }
    }
    // The newest request not taken yet. Take or wait often: it shows a PLC that the server lives.
    std::optional<Call> take() noexcept { return wait(calls::Nanoseconds::zero()); }
    // The newest request as soon as there is one. Nothing: status() is SHMGEN_NOTHING_NEW, or says why there never will.
    template <class Rep, class Period> std::optional<Call> wait(std::chrono::duration<Rep, Period> timeout) noexcept
    {
        std::optional<Request> request;
        std::uint32_t number = 0;
        status_ = callee_.take(calls::time_of(timeout), request, number);
        if (status_ != SHMGEN_OK || !request)
            return std::nullopt;
        callee_.begin(number);
        return Call{number, *request};
    }
    // SHMGEN_CALL_OVER: it was answered, or a newer call has been taken. A value that does not fit: the call still waits.
    Status reply(const Call &call, const Response &response) noexcept
    {
        typename Service::Reply made;
        made.call = call.number;
        made.status = Service::Reply::DONE;
        made.response = response;
        return callee_.answer(call.number, made);
    }
    Status fail(const Call &call) noexcept
    {
        typename Service::Reply made;
        made.call = call.number;
        made.status = Service::Reply::FAILED;
        return callee_.answer(call.number, made);
    }
    Status status() const noexcept { return status_; }
    std::string_view rejected() const noexcept { return callee_.rejected(); }

private:
    // However the handler ends: a call that was not answered has failed.
    struct Failing {
        Server &server;
        const Call &call;
        ~Failing() { server.fail(call); }
    };

    calls::Callee<Request, typename Service::Reply> callee_;
    Status status_ = SHMGEN_CLOSED;
};

} // namespace shmgen

#endif
