"""Service and action blocks of the open dialects work with Python's clients and servers through real regions."""

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
from .test_blocks import call_until_open, list_resources, wait_until

Generated = tuple[Path, dict[str, str], Layouts]
STATES = ("xDone", "xBusy", "xAborted", "xError")


@pytest.fixture
def ros(generated: Generated) -> SimpleNamespace:
    """The generated classes of services and actions."""
    classes: dict[str, Any] = {}
    for kind in ("srv", "action"):
        classes |= vars(build.module(generated[0], PACKAGE, TypeName("demo_msgs", kind, "")))
    return SimpleNamespace(**classes)


@pytest.fixture
def block(plc: Program, topic: str) -> Callable[..., Instance]:
    """A function that opens a client or server block of Start or Move."""

    def open_block(role: str, name: str = topic, **inputs: object) -> Any:
        action = role.startswith("Action")
        name_input = {"sAction" if action else "sService": name}
        kind = "Move" if action else "Start"
        return call_while_opening(plc.block(f"FB_demo_msgs_{kind}_{role}", xEnable=True, **name_input, **inputs))

    return open_block


def call_while_opening(block: Any) -> Any:
    """Call a block until it is open. A client reports no open state, because its calls wait for the regions."""
    for _ in range(30):
        block()
        time.sleep(0.0005)
    return call_until_open(block) if block._name.endswith("SERVER") else block


def state(client: Any) -> str:
    """Return the names of the state outputs that are TRUE, joined by plus signs."""
    return "+".join(name for name in STATES if getattr(client, name))


def start_call(client: Any, batch: int = 1) -> Any:
    client(xExecute=False)
    return client(xExecute=True, Request_batch=batch)


def random_messages(generated: Generated, name: str) -> Iterator[Any]:
    layout = next(it for it in generated[2].values() if it.name.short == f"demo_msgs/{name}")
    seed = random.Random(name)
    while True:
        yield random_message(layout, generated[2], seed)


def test_call_passes_through_a_plc_unchanged(block: Any, ros: Any, generated: Generated, topic: str) -> None:
    """Forward a call of Python's client through a server block and a client block to Python's server."""
    plc_server, plc_client = block("Server", f"{topic}/in"), block("Client", f"{topic}/out", tTimeout=5)
    requests, responses = random_messages(generated, "Start_Request"), random_messages(generated, "Start_Response")
    with ros.StartClient(f"{topic}/in") as client, ros.StartServer(f"{topic}/out") as server:
        assert client.server_is_ready()
        for _ in range(10):
            request, response = next(requests), next(responses)
            number = client.send(request)
            assert (plc_server().xExecute, plc_server.udiCall) == (1, number)
            plc_server.move(plc_client, "Request")
            assert state(plc_client(xExecute=True)) == "xBusy"
            call = server.take()
            assert plc_client.udiCall == call.number
            assert plain(call.request) == plain(request)
            assert state(plc_client()) == "xBusy"
            server.reply(call, response)
            assert (state(plc_client()), plc_client.eErrorID) == ("xDone", 0)
            plc_client.move(plc_server, "Response")
            assert plc_server(xDone=True).xExecute == 0
            assert plain(client.poll()) == plain(response)
            assert state(plc_client(xExecute=False)) == ""
            assert plc_server(xDone=False).xExecute == 0


def test_goal_passes_through_a_plc_unchanged(block: Any, ros: Any, generated: Generated, topic: str) -> None:
    plc_server, plc_client = block("ActionServer", f"{topic}/in", xSend=False), block("ActionClient", f"{topic}/out")
    goals, feedbacks, results = (random_messages(generated, f"Move_{part}") for part in ("Goal", "Feedback", "Result"))
    with ros.MoveActionClient(f"{topic}/in") as client, ros.MoveActionServer(f"{topic}/out") as server:
        for _ in range(5):
            goal, feedback, result = next(goals), next(feedbacks), next(results)
            number = client.send_goal(goal, timeout=5)
            assert (plc_server().xExecute, plc_server.udiGoal) == (1, number)
            plc_server.move(plc_client, "Goal")
            plc_client(xExecute=True)
            server_goal = server.take()
            assert plain(server_goal.request) == plain(goal)
            assert server_goal.publish_feedback(feedback)
            assert (state(plc_client()), plc_client.xNewFeedback, plc_client.siStatus) == ("xBusy", 1, 2)
            plc_client.move(plc_server, "Feedback")
            plc_server(xSend=True)
            assert plain(client.feedback()) == plain(feedback)
            assert plc_client().xNewFeedback == 0
            assert server_goal.succeed(result)
            assert (state(plc_client()), plc_client.siStatus) == ("xDone", 4)
            plc_client.move(plc_server, "Result")
            plc_server(xSend=False, xDone=True)
            outcome = client.poll()
            assert (outcome.status, plain(outcome.result)) == (4, plain(result))
            plc_server(xDone=False), plc_client(xExecute=False)


def test_client_block_reports_timeout_failure_and_cancel(block: Any, ros: Any, topic: str) -> None:
    client = block("Client", tTimeout=0.05)
    assert state(start_call(client)) == "xBusy"
    assert wait_until(lambda: state(client()) == "xError"), "no server exists"
    assert client.eErrorID == 50
    assert wait_until(lambda: client(xEnable=True).eErrorID == 50), "the error stays until xExecute falls"
    with ros.StartServer(topic) as server:
        assert server.take() is None, "a request from before the server's start is dropped"
        start_call(client, 2)
        server.fail(server.take())
        assert (state(client()), client.eErrorID) == ("xError", 51)
        start_call(client, 3)
        late = server.take()
        assert wait_until(lambda: state(client()) == "xError")
        assert client.eErrorID == 50
        client(tTimeout=0)
        start_call(client, 4)
        server.reply(late, ros.Start_Response(batch=3))
        assert state(client()) == "xBusy", "the reply was to the previous call"
        assert state(client(xCancel=True)) == "xAborted"
        client(xCancel=False)
        assert state(client(xExecute=False)) == ""
        assert client.eErrorID == 0
        start_call(client, 5)
        server.reply(server.wait(5), ros.Start_Response(batch=6, values=[1.0]))
        assert (state(client(xExecute=False)), client.Response_batch) == ("xDone", 6)
        assert state(client()) == "", "xDone is TRUE for one cycle"


def test_server_block_ends_calls_with_xdone_or_xfailed(block: Any, ros: Any, topic: str) -> None:
    server = block("Server")
    with ros.StartClient(topic) as client:
        client.send(ros.Start_Request(batch=1))
        assert server().xExecute == 1
        server(xFailed=True)
        with pytest.raises(runtime.CallFailed):
            client.poll()
        client.send(ros.Start_Request(batch=2))
        for _ in range(3):
            assert server().xExecute == 0, "xFailed of the last call does not end the next call"
        assert (server(xFailed=False).xExecute, server.Request_batch) == (1, 2)
        client.send(ros.Start_Request(batch=3))
        assert (server().xExecute, server.Request_batch) == (1, 2), "a server handles one call at a time"
        server(xDone=True, Response_batch=20)
        assert client.poll() is None, "the response was to the abandoned call"
        assert (server(xDone=False).xExecute, server.Request_batch) == (1, 3)
        server(xDone=True, Response_batch=30)
        assert client.poll().batch == 30


def test_count_above_its_bound_fails_the_call(block: Any, ros: Any, generated: Generated, topic: str) -> None:
    """Fail the call, whether the program of one side or a faulty peer wrote the count."""
    server, client = block("Server"), block("Client", f"{topic}/other")
    with ros.StartClient(topic) as caller, ros.StartServer(f"{topic}/other") as callee:
        caller.send(ros.Start_Request(batch=1))
        overwrite_count(generated, topic, "Start_Request", "codes_count")
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

        start_call(client(Request_codes_count=4))
        assert (state(client), client.eErrorID, callee.take()) == ("xError", 52, None)
        start_call(client(Request_codes_count=3))
        callee.reply(callee.take(), ros.Start_Response())
        overwrite_count(generated, f"{topic}/other", "Start_Reply", "response.values_count")
        assert (state(client()), client.eErrorID) == ("xError", 52)


def overwrite_count(generated: Generated, topic: str, name: str, field: str) -> None:
    """Write 9 over a count in the newest sample."""
    layout = next(it for it in generated[2].values() if it.name.short == f"demo_msgs/{name}")
    at = 0
    for part in field.split("."):
        slot = next(slot for slot in layout.slots if slot.name == part)
        at += slot.offset
        layout = generated[2].get(getattr(slot.type, "name", None), layout)  # type: ignore[arg-type]
    memory = Memory(topic, "-response" if name.endswith("_Reply") else "-request")
    words = memoryview(memory.bytes()[:64]).cast("I")
    memory.poke(abi.HEADER_SIZE + memory["completed0"] % memory["slots"] * words[5] + abi.SLOT_HEADER + at, bytes([9]))


def test_restarted_client_or_server_mixes_up_no_calls(block: Any, ros: Any, topic: str) -> None:
    """Serve no call twice, and give no call the response to another call."""
    server, client = block("Server"), block("Client", tTimeout=0)
    start_call(client, 1)
    assert server().xExecute == 1
    number = server.udiCall
    assert (server(xEnable=False).xExecute, server.udiCall) == (0, 0)
    call_until_open(server(xEnable=True))
    for _ in range(3):
        assert (server().xExecute, state(client())) == (0, "xBusy"), "the former server may have served the call"
    client(xCancel=True)
    start_call(client(xCancel=False), 2)
    assert (server().Request_batch, client.udiCall) == (2, number + 1)
    client(xEnable=False, xExecute=False)
    assert (state(client), client.udiCall) == ("", 0)
    call_while_opening(client(xEnable=True))
    start_call(client, 3)
    server(xDone=True, Response_batch=20)
    assert state(client()) == "xBusy", "the response was to the former client"
    server(xDone=False)
    assert (server().Request_batch, client.udiCall) == (3, number + 2)
    server(xDone=True, Response_batch=30)
    assert (state(client()), client.Response_batch) == ("xDone", 30)
    server(xEnable=False)
    with ros.StartServer(topic) as python:
        start_call(client, 4)
        python.reply(python.wait(5), ros.Start_Response(batch=40))
        assert (state(client()), client.Response_batch) == ("xDone", 40)
        second = block("Server")
        assert (second.xError, second.eErrorID) == (1, 40), "another server is open"
    assert wait_until(lambda: second().eErrorID == 0 and not second.xBusy)


CALLER = """
import sys, time
sys.path.insert(0, sys.argv[1])
from shm_msgs.demo_msgs.srv import StartClient, Start_Request
client = StartClient(sys.argv[2])
client.send(Start_Request(batch=7))
print("sent", flush=True)
time.sleep(60)
"""


def test_server_serves_the_next_client_after_a_kill(block: Any, ros: Any, generated: Generated, topic: str) -> None:
    """Drop the response to the killed client, and serve the call of the next client."""
    server = block("Server")
    line = [sys.executable, "-c", CALLER, str(generated[0] / "python"), topic]
    with subprocess.Popen(line, stdout=subprocess.PIPE) as process:
        assert process.stdout
        assert process.stdout.readline() == b"sent\n"
        assert wait_until(lambda: server().xExecute == 1)
        process.kill()
    with ros.StartClient(topic) as client:
        client.send(ros.Start_Request(batch=8))
        server(xDone=True, Response_batch=70)
        server(xDone=False)
        assert client.poll() is None
        assert server().Request_batch == 8
        server(xDone=True, Response_batch=80)
        assert client.poll().batch == 80


def test_call_blocks_do_not_wait_for_held_locks(block: Any, topic: str) -> None:
    """Start calls and goals while the locks are held. Waiting would show as voluntary context switches."""
    blocks = [block("Server"), block("Client", tTimeout=5), block("ActionServer"), block("ActionClient")]
    names = [f"{topic}-{half}" for half in ("request", "response", "goal", "result", "feedback")]
    for name in names:
        semaphore(name).acquire(0)
    numbers_before = 0, 0
    switches_before = resource.getrusage(resource.RUSAGE_THREAD).ru_nvcsw
    for number in range(200):
        for end in blocks:
            end(xExecute=number % 20 < 10) if end._name.endswith("CLIENT") else end(xDone=end.xExecute)
        if number == 0:
            numbers_before = blocks[1].udiCall, blocks[3].udiGoal
    assert resource.getrusage(resource.RUSAGE_THREAD).ru_nvcsw - switches_before < 20
    assert (blocks[1].udiCall - numbers_before[0], blocks[3].udiGoal - numbers_before[1]) == (9, 9)
    for name in names:
        semaphore(name).release()


def test_action_client_block_reports_how_goals_end(block: Any, ros: Any, topic: str) -> None:
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
        assert wait_until(lambda: state(client()) == "xError")
        assert (client.eErrorID, client.udiGoal) == (50, goal.number)
        assert goal.succeed(ros.Move_Result())
        assert state(client()) == "xError"


def test_action_server_block_ends_goals_with_each_status(block: Any, ros: Any, topic: str) -> None:
    server = block("ActionServer", Feedback_way=2)

    def end_goal(**inputs: object) -> tuple[int, int]:
        server(**inputs)
        server(**dict.fromkeys(inputs, False))
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
        assert end_goal(xAborted=True) == (5, 8)
        for inputs, status in (({"xFailed": True}, 6), ({"xReject": True}, -1), ({"xDone": True}, 4)):
            client.send_goal(ros.Move_Goal(target=9), timeout=5)
            assert (server().xExecute, server.xCancel) == (1, 0)
            assert end_goal(**inputs)[0] == status
        client.send_goal(ros.Move_Goal(target=1), timeout=5)
        server()
        client.send_goal(ros.Move_Goal(target=2), timeout=5)
        assert (server().xCancel, server.Goal_target) == (1, 1), "the newer goal waits until the older goal ends"
        client.cancel()
        server(), server()
        assert client.poll().status == 5, "the server has not taken the goal"
        assert (server(xAborted=True).xExecute, server(xAborted=False).xExecute) == (0, 0)


def test_disabled_call_blocks_close_their_regions(block: Any, plc: Program, topic: str) -> None:
    """Close all regions of disabled blocks. Also report an incompatible service and invalid names."""
    blocks = [block(role) for role in ("Server", "Client", "ActionServer", "ActionClient")]
    assert len(list_resources(topic)) >= 10, "five regions, from two sides"
    other = call_while_opening(plc.block("FB_demo_msgs_Stop_Client", xEnable=True, sService=topic))
    assert (other.eErrorID, state(other)) == (22, ""), "another service uses the name"
    other(xEnable=False)
    for instance in blocks:
        instance(xEnable=False)
        assert (instance.xBusy, instance.xError, instance.eErrorID) == (0, 0, 0)
    assert list_resources(topic) == []
    for name, error in (("", 1), ("//no", 2)):
        assert block("Server", name).eErrorID == block("Client", name).eErrorID == error
