"""Services and actions of the open dialects against Python's clients and servers, through real regions."""

from __future__ import annotations

import random
import resource
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest

from shmgen import runtime
from shmgen.core import abi
from shmgen.core.model import Layouts, TypeName

from ..support import build
from ..support.open_plc import Instance, Program
from ..support.plc_demo import Memory, semaphore
from ..support.schemas import plain, random_message
from .conftest import PACKAGE
from .test_blocks import held, ready, until

Made = tuple[Path, dict[str, str], Layouts]
ENDS = ("xDone", "xBusy", "xAborted", "xError")


@pytest.fixture
def ros(generated: Made) -> SimpleNamespace:
    """The generated classes of services and actions."""
    found: dict[str, Any] = {}
    for kind in ("srv", "action"):
        found |= vars(build.module(generated[0], PACKAGE, TypeName("demo_msgs", kind, "")))
    return SimpleNamespace(**found)


@pytest.fixture
def block(plc: Program, topic: str) -> Callable[..., Instance]:
    """One of the four of Start or Move, opened."""

    def opened(role: str, name: str = topic, **inputs: object) -> Any:
        action = role.startswith("Action")
        named = {"sAction" if action else "sService": name}
        kind = "Move" if action else "Start"
        return opening(plc.block(f"FB_demo_msgs_{kind}_{role}", xEnable=True, **named, **inputs))

    return opened


def opening(block: Any) -> Any:
    """Called as a cycle would; a client does not say when its regions are open, since a call waits for that."""
    for _ in range(30):
        block()
        time.sleep(0.0005)
    return ready(block) if block._name.endswith("SERVER") else block


def state(client: Any) -> str:
    """Which one of the four it is; more than one is none of them."""
    return "+".join(name for name in ENDS if getattr(client, name))


def begin(client: Any, batch: int = 1) -> Any:
    client(xExecute=False)
    return client(xExecute=True, Request_batch=batch)


def randoms(generated: Made, name: str) -> Iterator[Any]:
    layout = next(it for it in generated[2].values() if it.name.short == f"demo_msgs/{name}")
    seed = random.Random(name)
    while True:
        yield random_message(layout, generated[2], seed)


def test_a_call_passes_both_ways_through_a_plc(block: Any, ros: Any, generated: Made, topic: str) -> None:
    """Python's client, a server block, a client block, Python's server: all values come as they were."""
    served, calls = block("Server", f"{topic}/in"), block("Client", f"{topic}/out", tTimeout=5)
    requests, responses = randoms(generated, "Start_Request"), randoms(generated, "Start_Response")
    with ros.StartClient(f"{topic}/in") as client, ros.StartServer(f"{topic}/out") as server:
        assert client.server_is_ready()
        for _ in range(10):
            request, response = next(requests), next(responses)
            number = client.send(request)
            assert (served().xExecute, served.udiCall) == (1, number)
            served.move(calls, "Request")
            assert state(calls(xExecute=True)) == "xBusy"
            call = server.take()
            assert calls.udiCall == call.number
            assert plain(call.request) == plain(request)
            assert state(calls()) == "xBusy"
            server.reply(call, response)
            assert (state(calls()), calls.eErrorID) == ("xDone", 0)
            calls.move(served, "Response")
            assert served(xDone=True).xExecute == 0
            assert plain(client.poll()) == plain(response)
            assert state(calls(xExecute=False)) == ""
            assert served(xDone=False).xExecute == 0


def test_a_goal_passes_both_ways_through_a_plc(block: Any, ros: Any, generated: Made, topic: str) -> None:
    served, calls = block("ActionServer", f"{topic}/in", xSend=False), block("ActionClient", f"{topic}/out")
    goals, heard, results = (randoms(generated, f"Move_{part}") for part in ("Goal", "Feedback", "Result"))
    with ros.MoveActionClient(f"{topic}/in") as client, ros.MoveActionServer(f"{topic}/out") as server:
        for _ in range(5):
            goal, feedback, result = next(goals), next(heard), next(results)
            number = client.send_goal(goal, timeout=5)
            assert (served().xExecute, served.udiGoal) == (1, number)
            served.move(calls, "Goal")
            calls(xExecute=True)
            taken = server.take()
            assert plain(taken.request) == plain(goal)
            assert taken.publish_feedback(feedback)
            assert (state(calls()), calls.xNewFeedback, calls.siStatus) == ("xBusy", 1, 2)
            calls.move(served, "Feedback")
            served(xSend=True)
            assert plain(client.feedback()) == plain(feedback)
            assert calls().xNewFeedback == 0
            assert taken.succeed(result)
            assert (state(calls()), calls.siStatus) == ("xDone", 4)
            calls.move(served, "Result")
            served(xSend=False, xDone=True)
            outcome = client.poll()
            assert (outcome.status, plain(outcome.result)) == (4, plain(result))
            served(xDone=False), calls(xExecute=False)


def test_how_a_call_of_a_plc_ends(block: Any, ros: Any, topic: str) -> None:
    client = block("Client", tTimeout=0.05)
    assert state(begin(client)) == "xBusy"
    assert until(lambda: state(client()) == "xError"), "nobody serves"
    assert client.eErrorID == 50
    assert until(lambda: client(xEnable=True).eErrorID == 50), "it stays until xExecute falls"
    with ros.StartServer(topic) as server:
        assert server.take() is None, "what was sent before is old"
        begin(client, 2)
        server.fail(server.take())
        assert (state(client()), client.eErrorID) == ("xError", 51)
        begin(client, 3)
        late = server.take()
        assert until(lambda: state(client()) == "xError")
        assert client.eErrorID == 50
        client(tTimeout=0)
        begin(client, 4)
        server.reply(late, ros.Start_Response(batch=3))
        assert state(client()) == "xBusy", "that was to the call before"
        assert state(client(xCancel=True)) == "xAborted"
        client(xCancel=False)
        assert state(client(xExecute=False)) == ""
        assert client.eErrorID == 0
        begin(client, 5)
        server.reply(server.wait(5), ros.Start_Response(batch=6, values=[1.0]))
        assert (state(client(xExecute=False)), client.Response_batch) == ("xDone", 6)
        assert state(client()) == "", "seen for one cycle"


def test_how_a_call_to_a_plc_ends(block: Any, ros: Any, topic: str) -> None:
    server = block("Server")
    with ros.StartClient(topic) as client:
        client.send(ros.Start_Request(batch=1))
        assert server().xExecute == 1
        server(xFailed=True)
        with pytest.raises(runtime.CallFailed):
            client.poll()
        client.send(ros.Start_Request(batch=2))
        for _ in range(3):
            assert server().xExecute == 0, "the end of the last job is not that of the next"
        assert (server(xFailed=False).xExecute, server.Request_batch) == (1, 2)
        client.send(ros.Start_Request(batch=3))
        assert (server().xExecute, server.Request_batch) == (1, 2), "one at a time"
        server(xDone=True, Response_batch=20)
        assert client.poll() is None, "it was to the call given up"
        assert (server(xDone=False).xExecute, server.Request_batch) == (1, 3)
        server(xDone=True, Response_batch=30)
        assert client.poll().batch == 30


def test_a_count_above_its_bound_ends_the_call(block: Any, ros: Any, generated: Made, topic: str) -> None:
    """Whoever it comes from: the program on either side, or a peer that says so of what it has sent."""
    server, client = block("Server"), block("Client", f"{topic}/other")
    with ros.StartClient(topic) as caller, ros.StartServer(f"{topic}/other") as callee:
        caller.send(ros.Start_Request(batch=1))
        poke(generated, topic, "Start_Request", "codes_count")
        server()
        assert (server.xExecute, server.xError, server.eErrorID, server.udiRefused) == (0, 1, 52, 1)
        server()
        with pytest.raises(runtime.CallFailed):
            caller.poll()
        caller.send(ros.Start_Request(batch=2))
        assert (server().xExecute, server.eErrorID) == (1, 0)
        server(xDone=True, Response_values_count=3)
        assert server.eErrorID == 52
        with pytest.raises(runtime.CallFailed):
            caller.poll()
        server(xDone=False, Response_values_count=2)
        caller.send(ros.Start_Request(batch=3))
        assert (server().xExecute, server.eErrorID) == (1, 0)

        begin(client(Request_codes_count=4))
        assert (state(client), client.eErrorID, callee.take()) == ("xError", 52, None)
        begin(client(Request_codes_count=3))
        callee.reply(callee.take(), ros.Start_Response())
        poke(generated, f"{topic}/other", "Start_Reply", "response.values_count")
        assert (state(client()), client.eErrorID) == ("xError", 52)


def poke(generated: Made, topic: str, name: str, field: str) -> None:
    """Writes 9 over a count of the newest sample."""
    layout = next(it for it in generated[2].values() if it.name.short == f"demo_msgs/{name}")
    at = 0
    for part in field.split("."):
        slot = next(slot for slot in layout.slots if slot.name == part)
        at += slot.offset
        layout = generated[2].get(getattr(slot.type, "name", None), layout)  # type: ignore[arg-type]
    memory = Memory(topic, "-response" if name.endswith("_Reply") else "-request")
    words = memoryview(memory.bytes()[:64]).cast("I")
    memory.poke(abi.HEADER_SIZE + memory["completed0"] % memory["slots"] * words[5] + abi.SLOT_HEADER + at, bytes([9]))


def test_either_side_starts_anew(block: Any, ros: Any, topic: str) -> None:
    """No call is served twice, or gets the answer to another."""
    server, client = block("Server"), block("Client", tTimeout=0)
    begin(client, 1)
    assert server().xExecute == 1
    number = server.udiCall
    assert (server(xEnable=False).xExecute, server.udiCall) == (0, 0)
    ready(server(xEnable=True))
    for _ in range(3):
        assert (server().xExecute, state(client())) == (0, "xBusy"), "nobody knows whether it was served"
    client(xCancel=True)
    begin(client(xCancel=False), 2)
    assert (server().Request_batch, client.udiCall) == (2, number + 1)
    client(xEnable=False, xExecute=False)
    assert (state(client), client.udiCall) == ("", 0)
    opening(client(xEnable=True))
    begin(client, 3)
    server(xDone=True, Response_batch=20)
    assert state(client()) == "xBusy", "the answer is that to the former client"
    server(xDone=False)
    assert (server().Request_batch, client.udiCall) == (3, number + 2)
    server(xDone=True, Response_batch=30)
    assert (state(client()), client.Response_batch) == ("xDone", 30)
    server(xEnable=False)
    with ros.StartServer(topic) as python:
        begin(client, 4)
        python.reply(python.wait(5), ros.Start_Response(batch=40))
        assert (state(client()), client.Response_batch) == ("xDone", 40)
        second = block("Server")
        assert (second.xError, second.eErrorID) == (1, 40), "somebody serves"
    assert until(lambda: second().eErrorID == 0 and not second.xBusy)


CALLER = """
import sys, time
sys.path.insert(0, sys.argv[1])
from shm_msgs.demo_msgs.srv import StartClient, Start_Request
client = StartClient(sys.argv[2])
client.send(Start_Request(batch=7))
print("sent", flush=True)
time.sleep(60)
"""


def test_a_client_is_killed(block: Any, ros: Any, generated: Made, topic: str) -> None:
    """Its answer goes nowhere, and the next client's call is served."""
    server = block("Server")
    line = [sys.executable, "-c", CALLER, str(generated[0] / "python"), topic]
    with subprocess.Popen(line, stdout=subprocess.PIPE) as process:
        assert process.stdout
        assert process.stdout.readline() == b"sent\n"
        assert until(lambda: server().xExecute == 1)
        process.kill()
    with ros.StartClient(topic) as client:
        client.send(ros.Start_Request(batch=8))
        server(xDone=True, Response_batch=70)
        server(xDone=False)
        assert client.poll() is None
        assert server().Request_batch == 8
        server(xDone=True, Response_batch=80)
        assert client.poll().batch == 80


def test_nothing_waits_for_a_lock_that_somebody_holds(block: Any, topic: str) -> None:
    """A call that waits gives the processor away; a call goes on all the same where stores keep their order."""
    every = [block("Server"), block("Client", tTimeout=5), block("ActionServer"), block("ActionClient")]
    names = [f"{topic}-{half}" for half in ("request", "response", "goal", "result", "feedback")]
    for name in names:
        semaphore(name).acquire(0)
    first = 0, 0
    given_away = resource.getrusage(resource.RUSAGE_THREAD).ru_nvcsw
    for number in range(200):
        for one in every:
            one(xExecute=number % 20 < 10) if one._name.endswith("CLIENT") else one(xDone=one.xExecute)
        if number == 0:
            first = every[1].udiCall, every[3].udiGoal
    assert resource.getrusage(resource.RUSAGE_THREAD).ru_nvcsw - given_away < 20
    assert (every[1].udiCall - first[0], every[3].udiGoal - first[1]) == (9, 9)
    for name in names:
        semaphore(name).release()


def test_how_a_goal_of_a_plc_ends(block: Any, ros: Any, topic: str) -> None:
    client = block("ActionClient", tTimeout=0.3)
    with ros.MoveActionServer(topic) as server:
        client(xExecute=True, Goal_target=5)
        goal = server.take()
        assert (goal.request.target, goal.accept(), client().siStatus, client.xNewFeedback) == (5, True, 1, 0)
        client(xCancel=True)
        assert (state(client), goal.is_cancel_requested) == ("xBusy", True)
        assert goal.canceled(ros.Move_Result(way=3))
        assert (state(client()), client.siStatus, client.Result_way) == ("xAborted", 5, 3)
        client(xExecute=False, xCancel=False)
        client(xExecute=True)
        server.take().abort(ros.Move_Result(way=4))
        assert (state(client()), client.siStatus, client.eErrorID, client.Result_way) == ("xError", 6, 51, 4)
        client(xExecute=False)
        client(xExecute=True)
        server.take().reject()
        assert (state(client()), client.siStatus, client.eErrorID) == ("xError", -1, 51)
        client(xExecute=False)
        client(xExecute=True)
        goal = server.take()
        assert client.siStatus == 0
        assert until(lambda: state(client()) == "xError")
        assert (client.eErrorID, client.udiGoal) == (50, goal.number)
        assert goal.succeed(ros.Move_Result())
        assert state(client()) == "xError"


def test_how_a_goal_to_a_plc_ends(block: Any, ros: Any, topic: str) -> None:
    server = block("ActionServer", Feedback_way=2)

    def ended(**how: object) -> tuple[int, int]:
        server(**how)
        server(**dict.fromkeys(how, False))
        outcome = client.poll()
        return outcome.status, outcome.result.way

    with ros.MoveActionClient(topic) as client:
        client.send_goal(ros.Move_Goal(target=9), timeout=5)
        assert (server().xExecute, server.Goal_target, server.xCancel) == (1, 9, 0)
        server()
        assert (client.feedback().way, client.status) == (2, 2)
        client.cancel()
        assert (server().xCancel, server.xExecute) == (1, 1)
        server()
        client.feedback()
        assert client.status == 3
        server.Result_way = 8
        assert ended(xAborted=True) == (5, 8)
        for how, status in (({"xFailed": True}, 6), ({"xReject": True}, -1), ({"xDone": True}, 4)):
            client.send_goal(ros.Move_Goal(target=9), timeout=5)
            assert (server().xExecute, server.xCancel) == (1, 0)
            assert ended(**how)[0] == status
        client.send_goal(ros.Move_Goal(target=1), timeout=5)
        server()
        client.send_goal(ros.Move_Goal(target=2), timeout=5)
        assert (server().xCancel, server.Goal_target) == (1, 1), "the newer one waits for the end of the old"
        client.cancel()
        server(), server()
        assert client.poll().status == 5, "it was never taken"
        assert (server(xAborted=True).xExecute, server(xAborted=False).xExecute) == (0, 0)


def test_a_block_lets_go(block: Any, plc: Program, topic: str) -> None:
    """And what cannot work is told."""
    every = [block(role) for role in ("Server", "Client", "ActionServer", "ActionClient")]
    assert len(held(topic)) >= 10, "five regions, from two sides"
    other = opening(plc.block("FB_demo_msgs_Stop_Client", xEnable=True, sService=topic))
    assert (other.eErrorID, state(other)) == (22, ""), "another service has the name"
    other(xEnable=False)
    for one in every:
        one(xEnable=False)
        assert (one.xBusy, one.xError, one.eErrorID) == (0, 0, 0)
    assert held(topic) == []
    for name, error in (("", 1), ("//no", 2)):
        assert block("Server", name).eErrorID == block("Client", name).eErrorID == error
