"""Calls and goals after a region was removed: client and server reopen the region, and the next calls succeed."""

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


def combine(*names):
    return [halves for count in range(1, len(names) + 1) for halves in itertools.combinations(names, count)]


def remove(topic, halves):
    for half in halves:
        (Path("/dev/shm") / region_name(f"{topic}-{half}")).unlink()


def remove_and_call(topic, halves, call, ends):
    """Remove regions, and call until all are reopened and a call has succeeded in them."""
    counts = [end.reopen_count for end in ends]
    remove(topic, halves)
    deadline = time.monotonic() + SOON
    while time.monotonic() < deadline:
        is_reopened = all(end.reopen_count >= count + len(halves) for end, count in zip(ends, counts, strict=True))
        with suppress(runtime.CallTimeout):
            call()
            if is_reopened:
                return
    raise AssertionError([end.reopen_count - count for end, count in zip(ends, counts, strict=True)])


@pytest.mark.parametrize("halves", combine("request", "response"), ids="+".join)
def test_service_continues_after_regions_were_removed(topic, halves):
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
            remove_and_call(topic, halves, call, (client, server))
        server.close()
        serving.join()


def test_response_is_written_to_the_recreated_region(topic):
    with StartServer(topic) as server, StartClient(topic) as client:
        client.send(Start_Request(batch=4))
        call = server.wait(SOON)
        remove(topic, ["response"])
        time.sleep(0.12)
        assert server.take() is None
        assert server.reply(call, Start_Response(batch=8))
        assert not server.reply(call, Start_Response(batch=9)), "one response"
        assert client.wait(SOON).batch == 8


@pytest.mark.parametrize("halves", combine("goal", "feedback", "result"), ids="+".join)
def test_action_continues_after_regions_were_removed(topic, halves):
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
            remove_and_call(topic, halves, send, (client, server))
        server.close()
        serving.join()


@pytest.mark.parametrize("kind", [MoveActionServer, MoveActionClient, StartServer, StartClient])
def test_servers_and_clients_accept_the_same_options(topic, kind):
    with kind(topic, lock_timeout=0.001, mode=0o600, spin=0.0005, reopen=False) as end:
        assert end.reopen_count == 0
    with pytest.raises(ValueError, match="spin is 1"):
        kind(topic, spin=1)
