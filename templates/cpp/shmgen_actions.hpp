// Clients and servers of actions in C++17 (docs/protocol.md, "Actions").
//
// Made by shmgen; changes made here are lost.
#ifndef SHMGEN_ACTIONS_HPP
#define SHMGEN_ACTIONS_HPP

#include "shmgen_calls.hpp"

namespace shmgen {

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
                if (status_ != SHMGEN_NOTHING_NEW || calls::left(deadline) == calls::Nanoseconds::zero())
                    return status_;
                continue;
            }
            const Aborting aborting{*goal};
            goal->accept();
            handler(*goal);
        }
    }
    std::optional<Goal> take() noexcept { return wait(calls::Nanoseconds::zero()); }
    // The newest goal as soon as there is one. The one before it, if it has not ended, nobody waits for any more.
    template <class Rep, class Period> std::optional<Goal> wait(std::chrono::duration<Rep, Period> timeout) noexcept
    {
        const auto deadline = calls::deadline_of(calls::time_of(timeout));
        for (;;) {
            const calls::Nanoseconds rest = calls::left(deadline);
            look(waiting_ ? calls::Nanoseconds::zero() : rest);
            if (waiting_)
                return std::exchange(waiting_, std::nullopt);
            if (rest == calls::Nanoseconds::zero() || (status_ != SHMGEN_OK && status_ != SHMGEN_NOTHING_NEW))
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
    void look(calls::Nanoseconds timeout) noexcept
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
        look(calls::Nanoseconds::zero());
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
