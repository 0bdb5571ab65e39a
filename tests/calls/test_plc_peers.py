"""A PLC and Python on one service and one action: each serves the other, also after the PLC was killed."""

from __future__ import annotations

import subprocess
import sys
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import ExitStack
from types import ModuleType, SimpleNamespace
from typing import Any, TypeAlias

import pytest

from shmgen.core.model import TypeName
from shmgen.runtime import CallFailed, CallTimeout

from ..conftest import REPOSITORY
from ..support.build import module
from ..support.plc_calls import PACKAGE, Calls

StartTask: TypeAlias = "Callable[[str, str], subprocess.Popen[str]]"


@pytest.fixture
def srv(compiled_calls: Calls) -> ModuleType:
    return module(compiled_calls.folder, PACKAGE, TypeName("calls_msgs", "srv", "Ask"))


@pytest.fixture
def action(compiled_calls: Calls) -> ModuleType:
    return module(compiled_calls.folder, PACKAGE, TypeName("calls_msgs", "action", "Count"))


@pytest.fixture
def start(compiled_calls: Calls) -> Iterator[StartTask]:
    """A function that starts a program as the task of a PLC, with cycles of 1 ms, in a separate process."""
    with ExitStack() as processes:

        def task(program: str, setting: str) -> subprocess.Popen[str]:
            library = compiled_calls.folder / "plc" / "plc.so"
            command = [sys.executable, "-m", "tests.softplc.task", library, program, "--set", setting]
            process = processes.enter_context(
                subprocess.Popen(command, cwd=REPOSITORY, stdout=subprocess.PIPE, text=True)
            )
            processes.callback(process.kill)
            assert process.stdout
            assert process.stdout.readline() == "running\n"
            return process

        yield task


def question(number: int, cycles: int = 0, fail: bool = False) -> Any:
    return SimpleNamespace(question=number, cycles=cycles, fail=fail)


def test_plc_server_answers_python(srv: ModuleType, start: StartTask, topic: str) -> None:
    plc = start("PRG_Answer", f'sService="{topic}"')
    with srv.AskClient(topic) as client:
        assert [client.call(question(n), timeout=20).answer for n in range(100)] == [3 * n + 1 for n in range(100)]
        with pytest.raises(CallFailed):
            client.call(question(1, fail=True), timeout=20)
        with pytest.raises(CallTimeout):
            client.call(question(2, cycles=300), timeout=0.1)
        assert client.call(question(3), timeout=20).answer == 10
        client.send(question(4, cycles=10_000))
        time.sleep(0.05)
        plc.kill()
        start("PRG_Answer", f'sService="{topic}"')
        assert client.wait_for_server(20)
        time.sleep(0.1)
        assert client.poll() is None
        assert client.call(question(5), timeout=20).answer == 16


def test_python_server_answers_a_plc(compiled_calls: Calls, srv: ModuleType, topic: str) -> None:
    program = compiled_calls.plc.block("PRG_Ask")
    program.sService = topic
    stopping = threading.Event()

    def serve() -> None:
        with srv.AskServer(topic) as server:
            while not stopping.is_set():
                server.serve(answer, timeout=0.05)

    def answer(request: Any) -> Any:
        if request.question == 7:
            raise ValueError("not this one")
        return srv.Ask_Response(answer=3 * request.question + 1)

    thread = threading.Thread(target=serve)
    thread.start()
    try:
        for _ in range(200):
            program.run(0.001, 100)
            if program.udiRight > 50:
                break
    finally:
        stopping.set()
        thread.join()
    assert (program.udiRight > 50, program.udiWrong) == (True, 0)
    assert program.udiOther == 1, "question 7 fails"


def test_plc_server_executes_goals_of_python(action: ModuleType, start: StartTask, topic: str) -> None:
    start("PRG_Count", f'sAction="{topic}"')
    with action.CountActionClient(topic) as client:
        client.send_goal(action.Count_Goal(target=200), timeout=20)
        positions = []
        while (outcome := client.poll()) is None:
            if feedback := client.feedback():
                positions.append(feedback.position)
        assert (outcome.status, outcome.result.reached) == (outcome.SUCCEEDED, 200)
        assert len(positions) > 1
        assert sorted(set(positions)) == positions
        client.send_goal(action.Count_Goal(target=10**9), timeout=20)
        while not client.feedback():
            time.sleep(0.001)
        client.cancel()
        assert client.result(timeout=20).status == outcome.CANCELED
        client.send_goal(action.Count_Goal(target=1, stride=0), timeout=20)
        assert client.result(timeout=20).status == outcome.REJECTED
