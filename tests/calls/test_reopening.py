"""Calls and goals after a region was removed: client and server reopen it, and calls end again."""

from __future__ import annotations

import itertools
import threading
import time
from contextlib import suppress
from pathlib import Path

import pytest
from shm_service.cell_msgs.action import Move_Feedback, Move_Goal, Move_Result, MoveActionClient, MoveActionServer
from shm_service.cell_msgs.srv import Start_Request, Start_Response, StartClient, StartServer

from shmgen import runtime
from shmgen.runtime import region_name
from tests.support.engines import use_python
from tests.support.machine import slower

SOON = 10.0 * slower


@pytest.fixture(autouse=True, params=["Python", "C"])
def each_engine(request, monkeypatch):
    if request.param == "Python":
        use_python(monkeypatch)


def halves(*names):
    return [chosen for count in range(1, len(names) + 1) for chosen in itertools.combinations(names, count)]


def remove(topic, chosen):
    for half in chosen:
        (Path("/dev/shm") / region_name(f"{topic}-{half}")).unlink()


def goes_on(topic, chosen, call, ends):
    """Remove regions, and call until they are there again and a call has been answered in them."""
    counts = [end.reopen_count for end in ends]
    remove(topic, chosen)
    deadline = time.monotonic() + SOON
    while time.monotonic() < deadline:
        reopened = all(end.reopen_count >= count + len(chosen) for end, count in zip(ends, counts, strict=True))
        with suppress(runtime.CallTimeout):
            call()
            if reopened:
                return
    raise AssertionError([end.reopen_count - count for end, count in zip(ends, counts, strict=True)])


@pytest.mark.parametrize("chosen", halves("request", "response"), ids="+".join)
def test_a_service_goes_on(topic, chosen):
    with StartServer(topic) as server, StartClient(topic) as client:

        def serve():
            server.serve(lambda request: Start_Response(success=True, batch=2 * request.batch), timeout=8 * SOON)

        serving = threading.Thread(target=serve)
        serving.start()
        batches = itertools.count(1)

        def call():
            batch = next(batches)
            assert client.call(Start_Request(batch=batch), 0.3 * slower).batch == 2 * batch

        call()
        for _ in range(3):
            goes_on(topic, chosen, call, (client, server))
        server.close()
        serving.join()


def test_a_response_goes_into_the_region_that_replaced_a_removed_one(topic):
    with StartServer(topic) as server, StartClient(topic) as client:
        client.send(Start_Request(batch=4))
        call = server.wait(SOON)
        remove(topic, ["response"])
        time.sleep(0.12)
        assert server.take() is None
        assert server.reply(call, Start_Response(batch=8))
        assert not server.reply(call, Start_Response(batch=9)), "one response"
        assert client.wait(SOON).batch == 8


@pytest.mark.parametrize("chosen", halves("goal", "feedback", "result"), ids="+".join)
def test_an_action_goes_on(topic, chosen):
    def move(goal):
        goal.publish_feedback(Move_Feedback(position=goal.request.position / 2))
        goal.succeed(Move_Result(position=goal.request.position))

    with MoveActionServer(topic) as server, MoveActionClient(topic) as client:
        serving = threading.Thread(target=lambda: server.serve(move, timeout=8 * SOON))
        serving.start()
        positions = itertools.count(1.0)

        def send():
            position = next(positions)
            client.send_goal(Move_Goal(position=position), timeout=0.3 * slower)
            assert client.result(timeout=0.3 * slower).result.position == position
            client.feedback()

        send()
        for _ in range(3):
            goes_on(topic, chosen, send, (client, server))
        server.close()
        serving.join()


@pytest.mark.parametrize("kind", [MoveActionServer, MoveActionClient, StartServer, StartClient])
def test_all_ends_take_the_same_options(topic, kind):
    with kind(topic, lock_timeout=0.001, mode=0o600, spin=0.0005, reopen=False) as end:
        assert end.reopen_count == 0
    with pytest.raises(ValueError, match="spin is 1"):
        kind(topic, spin=1)
