// Clients and servers of services and actions in C++17 (docs/protocol.md, "Services" and "Actions").
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
using Time = std::chrono::nanoseconds;

template <class Rep, class Period> Time time_of(std::chrono::duration<Rep, Period> time) noexcept
{
    return Time(ns_of(time));
}

inline Time left(Clock::time_point deadline) noexcept
{
    return std::max(Time::zero(), std::chrono::duration_cast<Time>(deadline - Clock::now()));
}

inline Clock::time_point deadline_of(Time timeout) noexcept { return Clock::now() + std::min(timeout, Time(std::chrono::hours(876000))); }

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
    std::optional<Answer> wait(Time timeout) noexcept
    {
        const Clock::time_point deadline = deadline_of(timeout);
        while (number_ != 0) {
            const Time rest = left(deadline);
            std::optional<Answer> answer = own(answers_.wait(rest));
            if (answer || rest == Time::zero())
                return answer;
        }
        return std::nullopt;
    }
    bool server_is_ready() noexcept
    {
        return wait_for_server(writer() == SHMGEN_PLC ? Time(SHMGEN_CLAIM_MS * SHMGEN_MS) : Time::zero());
    }
    bool wait_for_server(Time timeout) noexcept
    {
        const Clock::time_point deadline = deadline_of(timeout);
        while (answers_.is_open() && !server_lives()) {
            const Time rest = left(deadline);
            if (rest == Time::zero())
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
    Status take(Time timeout, std::optional<Question> &question, std::uint32_t &number) noexcept
    {
        const Clock::time_point deadline = deadline_of(timeout);
        for (;;) {
            Status status = answers_.heartbeat();
            if (status != SHMGEN_OK)
                return status;
            const Time rest = left(deadline);
            question = rest == Time::zero() ? questions_.read()
                                            : questions_.wait(std::min(rest, Time(SHMGEN_SIGN_MS * SHMGEN_MS)));
            if (question) {
                number = questions_.sequence();
                return shmgen_publisher_assure(&answers_.c()); // or another server has taken over, and serves it
            }
            if (rest == Time::zero())
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
                if (status_ != SHMGEN_NOTHING_NEW || calls::left(deadline) == calls::Time::zero())
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
    std::optional<Call> take() noexcept { return wait(calls::Time::zero()); }
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

// Sends goals to one action, one at a time. `Action` names its Goal, Feedback, Result, Command, Progress and Outcome.
template <class Action> class ActionClient {
public:
    using Goal = typename Action::Goal;
    using Feedback = typename Action::Feedback;
    using Outcome = typename Action::Outcome;

    ActionClient() noexcept = default;
#if defined(__cpp_exceptions)
    explicit ActionClient(const std::string &action, const Options &options = {})
    {
        const Status status = open(action, options);
        if (status != SHMGEN_OK)
            throw Error(action, status);
    }
#endif
    [[nodiscard]] Status open(const std::string &action, const Options &options = {}) noexcept
    {
        status_ = caller_.open(action + "-goal", action + "-result", options);
        if (status_ == SHMGEN_OK)
            status_ = progress_.open((action + "-feedback").c_str(), options);
        return status_;
    }
    void close() noexcept
    {
        caller_.close();
        progress_.close();
    }

    // Waits for a server and sends the goal; one that still runs is given up. SHMGEN_NO_SERVER: nothing was sent.
    template <class Rep, class Period>
    [[nodiscard]] Status send_goal(const Goal &goal, std::chrono::duration<Rep, Period> timeout) noexcept
    {
        if (!caller_.wait_for_server(calls::time_of(timeout)))
            return status_ = SHMGEN_NO_SERVER;
        goal_status_ = 0;
        feedback_.reset();
        Command command;
        command.goal = goal;
        return status_ = caller_.ask(command);
    }
    // The newest feedback on the goal, once.
    std::optional<Feedback> feedback() noexcept
    {
        look();
        return std::exchange(feedback_, std::nullopt);
    }
    // Progress::ACCEPTED, EXECUTING or CANCELING; 0 = not taken yet.
    std::int8_t goal_status() noexcept
    {
        look();
        return goal_status_;
    }
    // How the goal ended, once: `status` and `result`.
    std::optional<Outcome> poll() noexcept { return caller_.poll(); }
    // Waits for the end of the goal, which goes on if that time runs out.
    template <class Rep, class Period> std::optional<Outcome> result(std::chrono::duration<Rep, Period> timeout) noexcept
    {
        std::optional<Outcome> outcome = caller_.wait(calls::time_of(timeout));
        status_ = outcome ? SHMGEN_OK : SHMGEN_CALL_TIMEOUT;
        return outcome;
    }
    // Asks the server to cancel the goal; result() then says how it ended.
    Status cancel() noexcept
    {
        Command command;
        command.cancel = caller_.number();
        return command.cancel != 0 ? caller_.tell(command) : SHMGEN_CALL_OVER;
    }
    bool server_is_ready() noexcept { return caller_.server_is_ready(); }
    template <class Rep, class Period> bool wait_for_server(std::chrono::duration<Rep, Period> timeout) noexcept
    {
        return caller_.wait_for_server(calls::time_of(timeout));
    }
    // Of the goal that has not ended, 0 = none.
    std::uint32_t number() const noexcept { return caller_.number(); }
    Status status() const noexcept { return status_; }
    std::string_view rejected() const noexcept { return caller_.rejected(); }

private:
    using Command = typename Action::Command;
    using Progress = typename Action::Progress;
    void look() noexcept
    {
        const std::optional<Progress> progress = progress_.read();
        if (progress && caller_.number() != 0 && progress->goal == caller_.number()) {
            goal_status_ = progress->status;
            if (goal_status_ != Progress::ACCEPTED)
                feedback_ = progress->feedback;
        }
    }

    calls::Caller<Command, Outcome, &Outcome::goal> caller_;
    Subscriber<Progress> progress_;
    std::optional<Feedback> feedback_;
    std::int8_t goal_status_ = 0;
    Status status_ = SHMGEN_CLOSED;
};

// Serves one action, one goal at a time. It stays where it is: its goals point to it.
template <class Action> class ActionServer {
public:
    using Feedback = typename Action::Feedback;
    using Result = typename Action::Result;
    using Outcome = typename Action::Outcome;

    // A goal that the server works on. What its calls send goes nowhere, and they say SHMGEN_CALL_OVER, once it has
    // ended or a newer one has come.
    class Goal {
    public:
        std::uint32_t number;
        typename Action::Goal request;

        // Whether the client has asked to cancel it, or sent a newer goal. Looking shows that the server lives.
        bool is_cancel_requested() noexcept { return server_->unwanted(number); }
        Status accept() noexcept { return server_->progress(number, Progress::ACCEPTED, Feedback()); }
        Status publish_feedback(const Feedback &feedback) noexcept
        {
            return server_->progress(number, server_->is_unwanted_ ? Progress::CANCELING : Progress::EXECUTING, feedback);
        }
        Status succeed(const Result &result) noexcept { return server_->end(number, Outcome::SUCCEEDED, result); }
        Status abort(const Result &result = Result()) noexcept { return server_->end(number, Outcome::ABORTED, result); }
        Status canceled(const Result &result = Result()) noexcept { return server_->end(number, Outcome::CANCELED, result); }
        Status reject() noexcept { return server_->end(number, Outcome::REJECTED, Result()); }

    private:
        friend ActionServer;
        Goal(std::uint32_t its, const typename Action::Goal &goal, ActionServer *server)
            : number(its), request(goal), server_(server)
        {
        }
        ActionServer *server_;
    };

    ActionServer() noexcept = default;
#if defined(__cpp_exceptions)
    explicit ActionServer(const std::string &action, const Options &options = {})
    {
        const Status status = open(action, options);
        if (status != SHMGEN_OK)
            throw Error(action, status);
    }
#endif
    ActionServer(const ActionServer &) = delete;
    ActionServer &operator=(const ActionServer &) = delete;
    [[nodiscard]] Status open(const std::string &action, const Options &options = {}) noexcept
    {
        status_ = progress_.open((action + "-feedback").c_str(), options);
        if (status_ == SHMGEN_OK)
            status_ = callee_.open(action + "-goal", action + "-result", options);
        return status_;
    }
    void close() noexcept
    {
        callee_.close();
        progress_.close();
    }

    // Accepts each goal and calls handler(goal), which ends it; one that it leaves without an end is ABORTED.
    template <class Handler, class Rep, class Period>
    Status serve(Handler &&handler, std::chrono::duration<Rep, Period> timeout)
    {
        const auto deadline = calls::deadline_of(calls::time_of(timeout));
        for (;;) {
            std::optional<Goal> goal = wait(calls::left(deadline));
            if (!goal) {
                if (status_ != SHMGEN_NOTHING_NEW || calls::left(deadline) == calls::Time::zero())
                    return status_;
                continue;
            }
            const Aborting aborting{*goal};
            goal->accept();
            handler(*goal);
        }
    }
    std::optional<Goal> take() noexcept { return wait(calls::Time::zero()); }
    // The newest goal as soon as there is one. The one before it, if it has not ended, nobody waits for any more.
    template <class Rep, class Period> std::optional<Goal> wait(std::chrono::duration<Rep, Period> timeout) noexcept
    {
        const auto deadline = calls::deadline_of(calls::time_of(timeout));
        for (;;) {
            const calls::Time rest = calls::left(deadline);
            look(waiting_ ? calls::Time::zero() : rest);
            if (waiting_)
                return std::exchange(waiting_, std::nullopt);
            if (rest == calls::Time::zero() || (status_ != SHMGEN_OK && status_ != SHMGEN_NOTHING_NEW))
                return std::nullopt;
        }
    }
    Status status() const noexcept { return status_; }
    std::string_view rejected() const noexcept { return callee_.rejected(); }

private:
    using Command = typename Action::Command;
    using Progress = typename Action::Progress;
    struct Aborting {
        Goal &goal;
        ~Aborting() { goal.abort(); }
    };

    // Takes one command. The number of the callee is that of the newest goal known.
    void look(calls::Time timeout) noexcept
    {
        std::optional<Command> command;
        std::uint32_t number = 0;
        status_ = callee_.take(timeout, command, number);
        if (status_ != SHMGEN_OK || !command)
            return;
        if (command->cancel == 0) {
            callee_.begin(number);
            is_unwanted_ = false;
            waiting_.emplace(Goal(number, command->goal, this));
        } else if (command->cancel == callee_.number() && !waiting_) {
            is_unwanted_ = true;
        } else { // nobody has taken that goal: it waits here, or its cancel has overwritten it
            callee_.begin(command->cancel);
            waiting_.reset();
            end(command->cancel, Outcome::CANCELED, Result());
        }
    }
    bool unwanted(std::uint32_t number) noexcept
    {
        look(calls::Time::zero());
        return is_unwanted_ || !callee_.awaits(number);
    }
    Status progress(std::uint32_t number, std::int8_t status, const Feedback &feedback) noexcept
    {
        if (!callee_.awaits(number))
            return SHMGEN_CALL_OVER;
        Progress made;
        made.goal = number;
        made.status = status;
        made.feedback = feedback;
        return progress_.publish(made);
    }
    Status end(std::uint32_t number, std::int8_t status, const Result &result) noexcept
    {
        Outcome made;
        made.goal = number;
        made.status = status;
        made.result = result;
        return callee_.answer(number, made);
    }

    calls::Callee<Command, Outcome> callee_;
    Publisher<Progress> progress_;
    std::optional<Goal> waiting_;
    bool is_unwanted_ = false;
    Status status_ = SHMGEN_CLOSED;
};

} // namespace shmgen

#endif
