"""Action blocks work with each other. A goal ends once, by its result, a cancel or a timeout.

Both run in one PLC here, whose clock changes only when a test sets it.
"""

from __future__ import annotations

import pytest

from tests.softplc import Block

from ..support.plc_calls import Calls, nth
from ..support.plc_demo import Memory, ready, take_over
from .test_services import state

EXECUTING, CANCELING, SUCCEEDED, CANCELED, ABORTED, REJECTED = 2, 3, 4, 5, 6, -1


def start_goal(client: Block, target: int) -> None:
    client(xExecute=False)
    client.Goal.target = target
    client(xExecute=True)


def end_goal(server: Block, output: str, reached: int = 0) -> None:
    server.Result.reached = reached
    server(**{output: True})
    server(**{output: False})


def open_pair(calls: Calls, topic: str) -> tuple[Block, Block]:
    """Open a server and then a client, and return both."""
    return ready(calls.action_server(topic)), ready(calls.action_client(topic))


def test_goal_gets_feedback_and_a_result(calls: Calls, topic: str) -> None:
    server, client = open_pair(calls, topic)
    start_goal(client, 3)
    assert (state(client), client.udiGoal, client.siStatus) == ("xBusy", nth(1), 0)
    assert (server().xExecute, server.Goal.target, server.udiGoal) == (True, 3, nth(1))
    for position in (1, 2):
        server.Feedback.position = position
        server()
        assert (client().xNewFeedback, client.Feedback.position, client.siStatus) == (True, position, EXECUTING)
        assert client().xNewFeedback is False
    end_goal(server, "xDone", 3)
    assert (state(client()), client.Result.reached, client.siStatus) == ("xDone", 3, SUCCEEDED)
    assert (server.xExecute, state(client(xExecute=False))) == (False, "")


@pytest.mark.parametrize(
    ("output", "expected", "error", "status"),
    [
        ("xFailed", "xError", "CALL_FAILED", ABORTED),
        ("xReject", "xError", "CALL_FAILED", REJECTED),
        ("xAborted", "xAborted", "NO_ERROR", CANCELED),
    ],
)
def test_client_reports_failures(calls: Calls, topic: str, output: str, expected: str, error: str, status: int) -> None:
    server, client = open_pair(calls, topic)
    start_goal(client, 3)
    server()
    end_goal(server, output)
    assert (state(client()), client.eErrorID, client.siStatus) == (expected, error, status)
    assert client.xNewFeedback is False


@pytest.mark.parametrize(("output", "expected"), [("xAborted", "xAborted"), ("xDone", "xDone"), ("xFailed", "xError")])
def test_server_decides_how_a_canceled_goal_ends(calls: Calls, topic: str, output: str, expected: str) -> None:
    server, client = open_pair(calls, topic)
    start_goal(client, 3)
    assert server().xCancel is False
    assert state(client(xCancel=True)) == "xBusy"
    assert (server().xCancel, server.xExecute) == (True, True)
    server()
    assert (state(client()), client.siStatus) == ("xBusy", CANCELING)
    end_goal(server, output)
    assert (server.xCancel, state(client())) == (False, expected)
    client(xCancel=False)
    start_goal(client, 4)
    assert (server().xExecute, server.xCancel, server.Goal.target) == (True, False, 4)


def test_cancel_before_the_goal_was_sent_sends_nothing(calls: Calls, topic: str) -> None:
    server, client = open_pair(calls, topic)
    calls.plc.fail("SysSemProcessEnter", 5)
    start_goal(client, 3)
    assert (client.udiGoal, state(client(xCancel=True))) == (0, "xAborted")
    calls.plc.fail("", 0)
    assert (client(xCancel=False).udiGoal, server().xExecute) == (0, False)


def test_server_never_executes_a_goal_canceled_early(calls: Calls, topic: str) -> None:
    server, client = open_pair(calls, topic)
    start_goal(client, 3)
    client(xCancel=True)
    for _ in range(2):
        assert server().xExecute is False
    assert (state(client()), client.siStatus) == ("xAborted", CANCELED)


def test_cancel_does_not_change_a_goal_that_has_ended(calls: Calls, topic: str) -> None:
    server, client = open_pair(calls, topic)
    start_goal(client, 3)
    server()
    end_goal(server, "xDone", 3)
    Memory(topic, "-result")["completed0"] = 0  # the client has not read the result yet
    assert state(client(xCancel=True)) == "xBusy"
    server(), server()
    Memory(topic, "-result")["completed0"] = 1
    assert (state(client()), client.Result.reached) == ("xDone", 3)


def test_new_goal_waits_until_the_old_goal_has_ended(calls: Calls, topic: str) -> None:
    """Request a cancel of the old goal, which its client gave up, and start the new goal afterwards."""
    server, client = open_pair(calls, topic)
    start_goal(client, 3)
    server()
    calls.plc.set_clock(10_000)
    assert (state(client()), client.eErrorID) == ("xError", "CALL_TIMEOUT")
    start_goal(client, 4)
    for _ in range(3):
        assert (server().xCancel, server.Goal.target, state(client())) == (True, 3, "xBusy")
    end_goal(server, "xAborted")
    assert state(client()) == "xBusy"
    assert (server().xExecute, server.xCancel, server.Goal.target) == (True, False, 4)


def test_waiting_goal_can_be_canceled(calls: Calls, topic: str) -> None:
    server, client = open_pair(calls, topic)
    start_goal(client, 3)
    server()
    calls.plc.set_clock(10_000)
    client()
    start_goal(client, 4)
    client(xCancel=True)
    server(), server()
    assert (state(client()), server.xExecute, server.Goal.target) == ("xAborted", True, 3)


def test_feedback_restarts_the_timeout(calls: Calls, topic: str) -> None:
    server, client = open_pair(calls, topic)
    start_goal(client, 3)
    server()
    for now in range(9_999, 60_000, 9_999):
        calls.plc.set_clock(now)
        server()
        assert state(client()) == "xBusy"
    server(xSend=False)
    calls.plc.set_clock(now + 10_000)
    server()
    assert (state(client()), client.eErrorID) == ("xError", "CALL_TIMEOUT")


def test_new_server_does_not_execute_an_old_goal(calls: Calls, topic: str) -> None:
    first, client = open_pair(calls, topic)
    start_goal(client, 3)
    first()
    second = ready(calls.action_server(topic))
    take_over(second)
    for _ in range(3):
        assert (second().xBusy, second.xExecute, state(client())) == (False, False, "xBusy")
    client(xCancel=True)  # the new server cancels the goal, which no server executes
    second(), second()
    assert (state(client()), client.siStatus) == ("xAborted", CANCELED)


def test_feedback_of_a_former_goal_is_ignored(calls: Calls, topic: str) -> None:
    server, client = open_pair(calls, topic)
    start_goal(client, 3)
    server()
    client(xEnable=False)
    server.Feedback.position = 7
    server()
    client(xEnable=True)
    start_goal(client, 4)
    server()
    assert (state(client()), client.xNewFeedback, client.siStatus) == ("xBusy", False, 0)


def test_disabled_blocks_reset_outputs_and_release_claims(calls: Calls, topic: str) -> None:
    server, client = open_pair(calls, topic)
    start_goal(client, 3)
    server()
    client(xEnable=False)
    server(xEnable=False)
    assert (state(client), server.xExecute, server.xError, server.xBusy) == ("", False, False, False)
    assert not any(Memory(topic, suffix)["writer"] for suffix in ("-goal", "-feedback", "-result"))


@pytest.mark.parametrize("suffix", ["-goal", "-feedback", "-result"])
def test_region_with_another_digest_is_an_error(calls: Calls, topic: str, suffix: str) -> None:
    open_pair(calls, topic)
    Memory(topic, suffix).poke(8, b"\x99")
    server, client = open_pair(calls, topic)
    start_goal(client, 3)
    assert (server.eErrorID, server.xError, state(client)) == ("DIGEST_MISMATCH", True, "xBusy")
    calls.plc.set_clock(10_000)
    assert (state(client()), client.eErrorID) == ("xError", "DIGEST_MISMATCH")
