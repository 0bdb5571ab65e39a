"""Tests of actions between processes: goals, feedback and cancels, and outcomes that belong to their own goals."""

from __future__ import annotations

import logging
import threading
import time
from types import SimpleNamespace

import pytest
from shm_service.cell_msgs.action import (
    Move_Feedback,
    Move_Goal,
    Move_Outcome,
    Move_Progress,
    Move_Result,
    MoveActionClient,
    MoveActionServer,
)

from shmgen import runtime
from shmgen.runtime.region import header as h
from tests.support.region_of import region_of

SERVE = """
def move(goal):
    at = 0.0
    while at < goal.request.position:
        if goal.is_cancel_requested:
            goal.canceled(Move_Result(position=at))
            return
        at += 1.0
        goal.publish_feedback(Move_Feedback(position=at))
        time.sleep(goal.request.speed)
    goal.succeed(Move_Result(position=at))

with MoveActionServer({topic!r}) as server:
    said("ready")
    server.serve(move)
"""
TAKE = """
with MoveActionServer({topic!r}) as server:
    said("ready")
    server.wait(20).accept()
    said("taken")
    time.sleep(20)
"""


@pytest.fixture
def pair(topic):
    with MoveActionServer(topic) as server, MoveActionClient(topic) as client:
        yield server, client


def start_goal(server, client, position=1.0):
    client.send_goal(Move_Goal(position=position), timeout=1)
    return server.take()


def test_goal_between_two_processes(topic, peer):
    peer(SERVE.format(topic=topic))
    with MoveActionClient(topic) as client:
        number = client.send_goal(Move_Goal(position=5.0, speed=0.05), timeout=10)
        positions = []
        while (outcome := client.poll()) is None:
            feedback = client.feedback()
            if feedback:
                positions.append(feedback.position)
            time.sleep(0.001)
        assert outcome == Move_Outcome(goal=number, status=Move_Outcome.SUCCEEDED, result=Move_Result(position=5.0))
        assert positions == sorted(set(positions))
        assert set(positions) <= {1.0, 2.0, 3.0, 4.0, 5.0}
        assert positions
        client.send_goal(Move_Goal(position=2.0, speed=0.0), timeout=10)
        assert client.result(10).result.position == 2.0


def test_cancelled_goal_between_two_processes(topic, peer):
    peer(SERVE.format(topic=topic))
    with MoveActionClient(topic) as client:
        client.send_goal(Move_Goal(position=1e6, speed=0.01), timeout=10)
        while not client.feedback():
            time.sleep(0.001)
        client.cancel()
        outcome = client.result(10)
        assert outcome.status == Move_Outcome.CANCELED
        assert 1 <= outcome.result.position < 1e6
        client.send_goal(Move_Goal(position=1.0, speed=0.0), timeout=10)
        assert client.result(10).status == Move_Outcome.SUCCEEDED


def test_goal_passes_through_its_statuses(pair):
    server, client = pair
    assert client.status == 0
    goal = start_goal(server, client, 3.0)
    assert goal.request == Move_Goal(position=3.0)
    assert client.status == 0
    assert goal.accept()
    assert client.status == Move_Progress.ACCEPTED
    assert client.feedback() is None
    assert goal.publish_feedback(SimpleNamespace(position=1.0))
    assert client.status == Move_Progress.EXECUTING
    assert client.feedback() == Move_Feedback(position=1.0)
    assert client.feedback() is None
    client.cancel()
    assert goal.is_cancel_requested
    assert goal.publish_feedback(Move_Feedback(position=2.0))
    assert client.status == Move_Progress.CANCELING
    assert client.poll() is None
    assert goal.canceled(Move_Result(position=2.0))
    assert client.poll() == Move_Outcome(
        goal=goal.number, status=Move_Outcome.CANCELED, result=Move_Result(position=2.0)
    )
    assert client.poll() is None


@pytest.mark.parametrize(("end", "status"), [("abort", "ABORTED"), ("canceled", "CANCELED"), ("reject", "REJECTED")])
def test_goal_may_end_without_a_result(pair, end, status):
    server, client = pair
    goal = start_goal(server, client)
    assert getattr(goal, end)()
    assert client.result(1).status == getattr(Move_Outcome, status)


def test_goal_ends_only_once(pair):
    server, client = pair
    goal = start_goal(server, client)
    assert goal.succeed(Move_Result(position=1.0))
    assert not goal.abort()
    assert not goal.publish_feedback(Move_Feedback())
    assert not goal.accept()
    assert client.result(1).status == Move_Outcome.SUCCEEDED


def test_invalid_result_leaves_the_goal_open(pair):
    server, client = pair
    goal = start_goal(server, client)
    with pytest.raises(runtime.ValueRejected, match=r"result\.position"):
        goal.succeed(SimpleNamespace(position="far"))
    assert goal.abort()
    assert client.result(1).status == Move_Outcome.ABORTED


def test_goal_that_a_handler_leaves_open_is_aborted(topic, caplog):
    def handler(goal):
        if goal.request.position == 2.0:
            raise OSError("jammed")

    with MoveActionServer(topic) as server, MoveActionClient(topic) as client, caplog.at_level(logging.ERROR, "shmgen"):
        thread = threading.Thread(target=server.serve, args=(handler, 2.0))
        thread.start()
        for position in (1.0, 2.0, 3.0):
            client.send_goal(Move_Goal(position=position), timeout=10)
            assert client.result(10).status == Move_Outcome.ABORTED
        thread.join()
    assert caplog.text.count("jammed") == 2  # in the source line and in the message of the traceback


def test_keyboardinterrupt_aborts_the_goal_and_ends_serve(pair):
    server, client = pair

    def handler(goal):
        raise KeyboardInterrupt

    client.send_goal(Move_Goal(), timeout=1)
    with pytest.raises(KeyboardInterrupt):
        server.serve(handler, timeout=5)
    assert client.result(1).status == Move_Outcome.ABORTED


def test_handler_receives_an_accepted_goal(pair, topic):
    server, client = pair
    assert client.server_is_ready()
    assert client.wait_for_server(0)
    assert not server.take()
    events = []

    def handler(goal):
        events.append((client.status, goal.number, goal.is_awaited))
        goal.succeed(Move_Result())
        events.append(goal.is_awaited)

    number = client.send_goal(Move_Goal(), timeout=1)
    server.serve(handler, timeout=0.05)
    assert events == [(Move_Progress.ACCEPTED, number, True), False]
    assert (client.action, server.action, server.client_lives()) == (topic, topic, True)
    client.close()
    assert not server.client_lives()


def test_server_waits_only_without_a_pending_goal(pair, monkeypatch):
    server, client = pair
    first = start_goal(server, client)
    client.send_goal(Move_Goal(position=2.0), timeout=1)
    timeouts, take = [], server._calls.take
    monkeypatch.setattr(server._calls, "take", lambda timeout: timeouts.append(timeout) or take(0.0))
    assert first.is_cancel_requested
    assert server.wait(30).request.position == 2.0
    assert server.take() is None
    assert timeouts == [0.0] * 3
    assert server.wait(0.01) is None
    assert 0 < timeouts[3] <= 0.01


def test_plc_client_lives_while_its_heartbeat_changes(topic, monkeypatch):
    now = time.monotonic()
    with MoveActionServer(topic) as server:
        words = region_of(server._calls._requests).words
        assert not server.client_lives()
        words[h.WRITER], words[h.HEARTBEAT] = h.PLC, 5
        assert server.client_lives()
        monkeypatch.setattr("shmgen.runtime.subscriber.time", SimpleNamespace(monotonic=lambda: now))
        now += 10.0
        assert not server.client_lives()
        for heartbeat, delay, is_alive in ((6, 0.0, True), (6, 0.99, True), (6, 0.02, False), (7, 0.0, True)):
            now += delay
            words[h.HEARTBEAT] = heartbeat
            assert server.client_lives() is is_alive


# --- cancels ---------------------------------------------------------------------------------------


def test_cancel_that_overwrites_its_goal_is_answered(pair):
    server, client = pair
    client.send_goal(Move_Goal(), timeout=1)
    client.cancel()
    assert server.take() is None
    assert client.result(1).status == Move_Outcome.CANCELED


def test_pending_goal_is_cancelled_while_another_runs(pair):
    server, client = pair
    first = start_goal(server, client)
    client.send_goal(Move_Goal(position=2.0), timeout=1)
    assert first.is_cancel_requested
    client.cancel()
    assert server.take() is None
    assert client.result(1).status == Move_Outcome.CANCELED
    assert not first.succeed(Move_Result())


def test_cancel_after_the_end_changes_nothing(pair):
    server, client = pair
    goal = start_goal(server, client)
    assert goal.succeed(Move_Result(position=1.0))
    client.cancel()
    assert server.take() is None
    assert client.result(1).status == Move_Outcome.SUCCEEDED
    client.cancel()  # without a goal, cancel() does nothing
    assert server.take() is None
    assert start_goal(server, client, 2.0).request.position == 2.0


def test_newer_goal_replaces_the_running_goal(pair):
    server, client = pair
    first = start_goal(server, client, 1.0)
    client.send_goal(Move_Goal(position=2.0), timeout=1)
    assert first.is_cancel_requested
    assert not first.publish_feedback(Move_Feedback())
    assert not first.canceled()
    second = server.take()
    assert second.request.position == 2.0
    assert not second.is_cancel_requested
    assert second.succeed(Move_Result(position=2.0))
    assert client.result(1).result.position == 2.0


# --- deaths ----------------------------------------------------------------------------------------


def test_restarted_server_ignores_old_goals_but_answers_cancels(topic, peer):
    first = peer(TAKE.format(topic=topic))
    with MoveActionClient(topic) as client:
        number = client.send_goal(Move_Goal(position=1.0), timeout=10)
        assert first.hear() == "taken"
        first.kill()
        with MoveActionServer(topic) as server:
            assert server.take() is None
            with pytest.raises(runtime.CallTimeout, match=f"goal {number} has not ended"):
                client.result(0.05)
            client.cancel()
            assert server.take() is None
            assert client.result(1).status == Move_Outcome.CANCELED
            assert start_goal(server, client, 2.0).request.position == 2.0


@pytest.mark.parametrize("is_uncertain", [False, True])
@pytest.mark.parametrize("half", ["progress_publisher", "outcome_publisher"])
def test_uncertain_claim_skips_stale_goals_again(topic, monkeypatch, half, is_uncertain):
    class LatePublisher(getattr(MoveActionServer, half)):
        def __init__(self, *arguments, **options):
            super().__init__(*arguments, **options)
            client._calls.send_request(SimpleNamespace(cancel=0, goal=Move_Goal()))
            self._end.predecessor_may_be_alive = is_uncertain

    monkeypatch.setattr(MoveActionServer, half, LatePublisher)
    with MoveActionClient(topic) as client, MoveActionServer(topic) as server:
        assert (server.take() is None) == is_uncertain


def test_client_gets_no_outcome_of_a_killed_client(topic, peer):
    first = peer(f"""
client = MoveActionClient({topic!r})
said("ready")
client.send_goal(Move_Goal(position=1.0), timeout=20)
time.sleep(20)
""")
    with MoveActionServer(topic) as server:
        old = server.wait(20)
        first.kill()
        with MoveActionClient(topic) as client:
            client.send_goal(Move_Goal(position=2.0), timeout=1)
            old.publish_feedback(Move_Feedback(position=0.5))
            old.succeed(Move_Result(position=1.0))
            assert client.feedback() is None
            assert client.poll() is None
            assert server.take().succeed(Move_Result(position=2.0))
            assert client.poll().result.position == 2.0


def test_client_can_cancel_the_goal_of_a_former_client(topic):
    with MoveActionServer(topic) as server:
        with MoveActionClient(topic) as former:
            former.cancel_former()  # no former client left a goal
            assert server.take() is None
            goal = start_goal(server, former)
            assert goal.publish_feedback(Move_Feedback(position=0.5))
            former.cancel_former()  # no effect, because this client has a goal itself
            assert not goal.is_cancel_requested
        with MoveActionClient(topic) as client:
            assert (client.status, client.feedback()) == (0, None)
            assert goal.publish_feedback(Move_Feedback(position=0.7))
            client.cancel_former()
            assert goal.is_cancel_requested


def test_client_sends_nothing_without_a_server(topic):
    with MoveActionClient(topic) as client:
        with pytest.raises(runtime.NoServer):
            client.send_goal(Move_Goal(), timeout=0.05)
        with pytest.raises(runtime.CallTimeout, match="no goal"):
            client.result(1)
        assert not client.server_is_ready()


def test_action_has_one_client_and_one_server(topic, pair):
    for kind in (MoveActionClient, MoveActionServer):
        with pytest.raises(runtime.RegionInUse):
            kind(topic)
