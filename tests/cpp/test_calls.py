"""Services and actions with C++ at one end and C++, Python or a PLC at the other: calls end alike everywhere."""

from __future__ import annotations

import os
import subprocess
import sys
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import ExitStack
from pathlib import Path
from types import ModuleType
from typing import Any

import pytest

from shmgen.core.model import TypeName
from shmgen.runtime import CallFailed, CallTimeout, region_name

from ..conftest import REPOSITORY
from ..support import cpp_peer, kept
from ..support.build import module
from ..support.cpp_peer import Peer
from ..support.machine import slower
from ..support.plc_calls import DEFINITIONS, PACKAGE, Calls
from ..support.plc_demo import Memory, semaphore

FAILED, TIMEOUT, NO_SERVER, NOTHING, LOCK_TIMEOUT = 51, 50, 54, 100, 33
SUCCEEDED, CANCELED, REJECTED = 4, 5, -1


@pytest.fixture(scope="session")
def program(generated: Path) -> Path:
    folder = generated / "calls"
    with kept.locked(folder / "lock"):
        if not (folder / "cpp").exists():
            cpp_peer.generate(folder, DEFINITIONS, package=PACKAGE)
    return cpp_peer.compiled(folder, "calls", cpp_peer.HERE / "calls.cpp")


@pytest.fixture
def srv(compiled_calls: Calls) -> ModuleType:
    return module(compiled_calls.folder, PACKAGE, TypeName("calls_msgs", "srv", "Ask"))


@pytest.fixture
def action(compiled_calls: Calls) -> ModuleType:
    return module(compiled_calls.folder, PACKAGE, TypeName("calls_msgs", "action", "Count"))


@pytest.fixture
def serve(
    peer: Callable[..., Peer], compiled_calls: Calls, srv: ModuleType, action: ModuleType, topic: str
) -> Iterator[Callable[[str, str], Any]]:
    """A function that starts a server of Ask or Count in a language. The server stops after the test."""
    with ExitStack() as stack:

        def start(language: str, name: str) -> Any:
            if language == "cpp":
                process = peer()
                process.tell(f"{'serve' if name == 'Ask' else 'act'} {topic} 20000")
                assert process.hear() == "0"
                stack.callback(process.kill)
                return process
            if language == "plc":
                program, key = {"Ask": ("PRG_Answer", "sService"), "Count": ("PRG_Count", "sAction")}[name]
                library = compiled_calls.folder / "plc" / "plc.so"
                command = [sys.executable, "-m", "tests.softplc.task", library, program, "--set", f'{key}="{topic}"']
                plc = stack.enter_context(subprocess.Popen(command, cwd=REPOSITORY, stdout=subprocess.PIPE, text=True))
                stack.callback(plc.kill)
                assert plc.stdout
                assert plc.stdout.readline() == "running\n"
                return plc
            stopping = threading.Event()
            server = srv.AskServer(topic) if name == "Ask" else action.CountActionServer(topic)

            def run() -> None:
                with server:
                    while not stopping.is_set():
                        server.serve(answer if name == "Ask" else count, timeout=0.02)

            def answer(request: Any) -> Any:
                time.sleep(request.cycles / 1000)
                if request.fail:
                    raise ValueError("told to")
                return srv.Ask_Response(answer=3 * request.question + 1, copies=[3 * request.question + 1] * 16)

            def count(goal: Any) -> None:
                reached = 0
                if not goal.request.stride:
                    goal.reject()
                    return
                while reached < goal.request.target:
                    if goal.is_cancel_requested:
                        goal.canceled(action.Count_Result(reached=reached))
                        return
                    reached += goal.request.stride
                    goal.publish_feedback(action.Count_Feedback(position=reached))
                    time.sleep(0.001)
                goal.succeed(action.Count_Result(reached=reached))

            thread = threading.Thread(target=run)
            thread.start()
            stack.callback(thread.join)
            stack.callback(stopping.set)
            return server

        yield start


@pytest.mark.parametrize("language", ["cpp", "python", "plc"])
def test_cpp_client(language: str, serve: Callable[[str, str], Any], peer: Callable[..., Peer], topic: str) -> None:
    client = peer()
    assert client.ask(f"client {topic}") == "0"
    assert client.ask("ask 1 0 0 30") == str(NO_SERVER)
    serve(language, "Ask")
    assert client.ask("ready 20000") == "1"
    for question in range(50):
        assert client.ask(f"ask {question} 0 0 20000") == f"0 {3 * question + 1}"
    assert client.ask("ask 1 0 1 20000") == str(FAILED)
    assert client.ask("ask 2 300 0 20") == str(TIMEOUT)
    assert client.ask("ask 3 0 0 20000") == "0 10", "the reply to this call, not to the call before"
    assert client.ask("send 4 0") == "0"
    while (response := client.ask("poll")) == str(NOTHING):
        pass
    assert response == "0 13"
    assert client.ask("poll") == str(NOTHING)


def test_cpp_server_ignores_old_calls(serve: Callable[[str, str], Any], srv: ModuleType, topic: str) -> None:
    with srv.AskClient(topic) as client:
        client.send(srv.Ask_Request(question=99))
        process = serve("cpp", "Ask")
        assert client.wait_for_server(20)
        time.sleep(0.1)
        assert Memory(topic, "-response")["completed0"] == 0, "the old call was served"
        assert [client.call(srv.Ask_Request(question=n), timeout=20).answer for n in range(50)] == [
            3 * n + 1 for n in range(50)
        ]
        with pytest.raises(CallFailed):
            client.call(srv.Ask_Request(question=1, fail=True), timeout=20)
        with pytest.raises(CallTimeout):
            client.call(srv.Ask_Request(question=2, cycles=300), timeout=0.02)
        assert client.call(srv.Ask_Request(question=3), timeout=20).answer == 10
        process.kill()
        assert not client.server_is_ready()
        serve("cpp", "Ask")
        assert client.call(srv.Ask_Request(question=4), timeout=20).answer == 13


def test_cpp_server_answers_a_plc(serve: Callable[[str, str], Any], compiled_calls: Calls, topic: str) -> None:
    serve("cpp", "Ask")
    program = compiled_calls.plc.block("PRG_Ask")
    program.sService = topic
    for _ in range(200):
        program.run(0.001, 100)
        if program.udiRight > 50:
            break
    assert (program.udiRight > 50, program.udiWrong, program.udiOther) == (True, 0, 0)


@pytest.mark.parametrize("language", ["cpp", "python", "plc"])
def test_cpp_client_sends_goals(
    language: str, serve: Callable[[str, str], Any], peer: Callable[..., Peer], topic: str
) -> None:
    client = peer()
    assert client.ask(f"goals {topic}") == "0"
    assert client.ask("goal 5 1 30") == str(NO_SERVER)
    serve(language, "Count")
    assert client.ask("goal 50 1 20000") == "0"
    positions = []
    while not (words := client.ask("progress").split())[1:] or len(positions) < 3:
        positions += words[1:]
    assert sorted(set(positions), key=int) == positions
    assert client.ask("result 20000") == f"0 {SUCCEEDED} 50"
    assert client.ask("goal 1000000000 1 20000") == "0"
    assert client.ask("result 20") == str(TIMEOUT)
    assert client.ask("cancel") == "0"
    assert client.ask("result 20000").split()[:2] == ["0", str(CANCELED)]
    assert client.ask("goal 1 0 20000") == "0"
    assert client.ask("result 20000").split()[:2] == ["0", str(REJECTED)]


def test_cpp_server_executes_goals_of_python(serve: Callable[[str, str], Any], action: ModuleType, topic: str) -> None:
    serve("cpp", "Count")
    with action.CountActionClient(topic) as client:
        client.send_goal(action.Count_Goal(target=20), timeout=20)
        assert client.result(timeout=20).result.reached == 20
        client.send_goal(action.Count_Goal(target=10**9), timeout=20)
        while not client.feedback():
            time.sleep(0.001)
        client.cancel()
        assert client.result(timeout=20).status == CANCELED
        client.send_goal(action.Count_Goal(target=10**9), timeout=20)
        client.send_goal(action.Count_Goal(target=3), timeout=20)
        assert client.result(timeout=20).status == SUCCEEDED, "the newer goal ends"


@pytest.mark.slow
def test_lock_of_a_dead_holder_is_recovered_during_a_call(program: Path, generated: Path, topic: str) -> None:
    """Recover the lock of either region on machines that need it, but never exceed the timeout of a call."""
    options = ["-DSHMGEN_KEEPS_ORDER=0"]
    executable = cpp_peer.compiled(generated / "calls", "needing", cpp_peer.HERE / "calls.cpp", options=options)
    server, client = Peer(executable), Peer(executable)
    try:
        assert (server.does(f"serve {topic} 20000"), client.does(f"client {topic}")) == (0, 0)
        assert client.ask("ask 1 0 0 10000") == "0 4"
        for half, question in (("-request", 2), ("-response", 3)):
            leave_lock_held(topic + half, dead=True)
            assert client.ask(f"ask {question} 0 0 10000") == f"0 {3 * question + 1}"
        leave_lock_held(topic + "-request", dead=False)
        started_at = time.monotonic()
        assert client.ask("ask 4 0 0 100").split()[0] == str(LOCK_TIMEOUT)
        assert 0.1 <= time.monotonic() - started_at < 10
        assert client.ask("ask 5 0 0 10000") == "0 16"
    finally:
        server.kill()
        server.close()
        client.close()


def leave_lock_held(topic: str, *, dead: bool) -> None:
    """Leave the lock held by a dead process or by this process."""
    semaphore(topic).acquire()
    memory = Memory(topic)
    memory["lock_count"] += 1
    memory["lock_holder"] = 2**22 + 1 if dead else os.getpid()


@pytest.mark.parametrize("language", ["cpp", "python", "plc"])
def test_calls_continue_after_the_regions_were_removed(
    language: str, serve: Callable[[str, str], Any], peer: Callable[..., Peer], topic: str
) -> None:
    """Reopen both regions in the client and in its server, and answer the next call within a second."""
    files = [Path(f"/dev/shm/{region_name(topic)}-{half}") for half in ("request", "response")]
    client = peer()
    assert client.ask(f"client {topic}") == "0"
    serve(language, "Ask")
    assert client.ask("ready 20000") == "1"
    for question in (1, 2):
        assert client.ask(f"ask {question} 0 0 1000") == f"0 {3 * question + 1}"
        for file in files:
            file.unlink()
        deadline = time.monotonic() + 1.5 * slower
        while time.monotonic() < deadline:
            is_reopened = all(file.exists() for file in files)
            is_answered = client.ask("ask 7 0 0 300") == "0 22"
            if is_reopened and is_answered:
                break
        assert is_reopened
        assert is_answered
