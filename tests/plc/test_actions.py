"""The blocks of an action, running against each other: a goal ends once, by its own outcome, a cancel or a time limit.

Both stand in one PLC here, whose clock stands still but for what a test adds to it.
"""

from __future__ import annotations

import pytest

from tests.softplc import Block

from ..support.plc_calls import Calls, nth
from ..support.plc_demo import Memory, ready, take_over
from .test_services import state

EXECUTING, CANCELING, SUCCEEDED, CANCELED, ABORTED, REJECTED = 2, 3, 4, 5, 6, -1


def begin(client: Block, target: int) -> None:
    client(xExecute=False)
    client.Goal.target = target
    client(xExecute=True)


def end(server: Block, how: str, reached: int = 0) -> None:
    server.Result.reached = reached
    server(**{how: True})
    server(**{how: False})


def pair(calls: Calls, topic: str) -> tuple[Block, Block]:
    """In this order: a server is there first."""
    return ready(calls.action_server(topic)), ready(calls.action_client(topic))


def test_a_goal_its_feedback_and_its_result(calls: Calls, topic: str) -> None:
    server, client = pair(calls, topic)
    begin(client, 3)
    assert (state(client), client.udiGoal, client.siStatus) == ("xBusy", nth(1), 0)
    assert (server().xExecute, server.Goal.target, server.udiGoal) == (True, 3, nth(1))
    for position in (1, 2):
        server.Feedback.position = position
        server()
        assert (client().xNewFeedback, client.Feedback.position, client.siStatus) == (True, position, EXECUTING)
        assert client().xNewFeedback is False
    end(server, "xDone", 3)
    assert (state(client()), client.Result.reached, client.siStatus) == ("xDone", 3, SUCCEEDED)
    assert (server.xExecute, state(client(xExecute=False))) == (False, "")


@pytest.mark.parametrize(
    ("how", "seen", "error", "status"),
    [
        ("xFailed", "xError", "CALL_FAILED", ABORTED),
        ("xReject", "xError", "CALL_FAILED", REJECTED),
        ("xAborted", "xAborted", "NO_ERROR", CANCELED),
    ],
)
def test_other_ends(calls: Calls, topic: str, how: str, seen: str, error: str, status: int) -> None:
    server, client = pair(calls, topic)
    begin(client, 3)
    server()
    end(server, how)
    assert (state(client()), client.eErrorID, client.siStatus) == (seen, error, status)
    assert client.xNewFeedback is False


@pytest.mark.parametrize(("how", "seen"), [("xAborted", "xAborted"), ("xDone", "xDone"), ("xFailed", "xError")])
def test_cancel_is_a_wish(calls: Calls, topic: str, how: str, seen: str) -> None:
    server, client = pair(calls, topic)
    begin(client, 3)
    assert server().xCancel is False
    assert state(client(xCancel=True)) == "xBusy"
    assert (server().xCancel, server.xExecute) == (True, True)
    server()
    assert (state(client()), client.siStatus) == ("xBusy", CANCELING)
    end(server, how)
    assert (server.xCancel, state(client())) == (False, seen)
    client(xCancel=False)
    begin(client, 4)
    assert (server().xExecute, server.xCancel, server.Goal.target) == (True, False, 4)


def test_cancel_before_it_was_sent(calls: Calls, topic: str) -> None:
    server, client = pair(calls, topic)
    calls.plc.fail("SysSemProcessEnter", 5)
    begin(client, 3)
    assert (client.udiGoal, state(client(xCancel=True))) == (0, "xAborted")
    calls.plc.fail("", 0)
    assert (client(xCancel=False).udiGoal, server().xExecute) == (0, False)


def test_cancel_before_it_was_taken(calls: Calls, topic: str) -> None:
    server, client = pair(calls, topic)
    begin(client, 3)
    client(xCancel=True)
    for _ in range(2):
        assert server().xExecute is False
    assert (state(client()), client.siStatus) == ("xAborted", CANCELED)


def test_cancel_of_what_has_just_ended(calls: Calls, topic: str) -> None:
    server, client = pair(calls, topic)
    begin(client, 3)
    server()
    end(server, "xDone", 3)
    Memory(topic, "-result")["completed0"] = 0  # not seen yet
    assert state(client(xCancel=True)) == "xBusy"
    server(), server()
    Memory(topic, "-result")["completed0"] = 1
    assert (state(client()), client.Result.reached) == ("xDone", 3)


def test_a_new_goal_while_one_runs(calls: Calls, topic: str) -> None:
    """Its client gave it up: the job is asked to end, and the new goal waits until it has."""
    server, client = pair(calls, topic)
    begin(client, 3)
    server()
    calls.plc.set_clock(10_000)
    assert (state(client()), client.eErrorID) == ("xError", "CALL_TIMEOUT")
    begin(client, 4)
    for _ in range(3):
        assert (server().xCancel, server.Goal.target, state(client())) == (True, 3, "xBusy")
    end(server, "xAborted")
    assert state(client()) == "xBusy"
    assert (server().xExecute, server.xCancel, server.Goal.target) == (True, False, 4)


def test_a_new_goal_that_is_cancelled_while_the_old_one_runs(calls: Calls, topic: str) -> None:
    server, client = pair(calls, topic)
    begin(client, 3)
    server()
    calls.plc.set_clock(10_000)
    client()
    begin(client, 4)
    client(xCancel=True)
    server(), server()
    assert (state(client()), server.xExecute, server.Goal.target) == ("xAborted", True, 3)


def test_the_time_limit_begins_anew_with_every_sign(calls: Calls, topic: str) -> None:
    server, client = pair(calls, topic)
    begin(client, 3)
    server()
    for now in range(9_999, 60_000, 9_999):
        calls.plc.set_clock(now)
        server()
        assert state(client()) == "xBusy"
    server(xSend=False)
    calls.plc.set_clock(now + 10_000)
    server()
    assert (state(client()), client.eErrorID) == ("xError", "CALL_TIMEOUT")


def test_a_new_server_knows_no_old_goal(calls: Calls, topic: str) -> None:
    first, client = pair(calls, topic)
    begin(client, 3)
    first()
    second = ready(calls.action_server(topic))
    take_over(second)
    for _ in range(3):
        assert (second().xBusy, second.xExecute, state(client())) == (False, False, "xBusy")
    client(xCancel=True)  # what it does know is that this goal is not being worked at
    second(), second()
    assert (state(client()), client.siStatus) == ("xAborted", CANCELED)


def test_feedback_of_a_former_goal(calls: Calls, topic: str) -> None:
    server, client = pair(calls, topic)
    begin(client, 3)
    server()
    client(xEnable=False)
    server.Feedback.position = 7
    server()
    client(xEnable=True)
    begin(client, 4)
    server()
    assert (state(client()), client.xNewFeedback, client.siStatus) == ("xBusy", False, 0)


def test_disabled_it_is_as_new(calls: Calls, topic: str) -> None:
    server, client = pair(calls, topic)
    begin(client, 3)
    server()
    client(xEnable=False)
    server(xEnable=False)
    assert (state(client), server.xExecute, server.xError, server.xBusy) == ("", False, False, False)
    assert not any(Memory(topic, suffix)["writer"] for suffix in ("-goal", "-feedback", "-result"))


@pytest.mark.parametrize("suffix", ["-goal", "-feedback", "-result"])
def test_what_cannot_be_opened(calls: Calls, topic: str, suffix: str) -> None:
    pair(calls, topic)
    Memory(topic, suffix).poke(8, b"\x99")
    server, client = pair(calls, topic)
    begin(client, 3)
    assert (server.eErrorID, server.xError, state(client)) == ("DIGEST_MISMATCH", True, "xBusy")
    calls.plc.set_clock(10_000)
    assert (state(client()), client.eErrorID) == ("xError", "DIGEST_MISMATCH")
