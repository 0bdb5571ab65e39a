"""Tests of services and actions in C: all tests of C++, and tests that detect faults planted in C or C++."""

# ruff: noqa: F811 (fixtures come from test_calls)

from __future__ import annotations

import shutil
import subprocess
import time
from collections.abc import Callable
from pathlib import Path
from types import ModuleType
from typing import Any

import pytest

from shmgen.core import abi

from ..support import cpp_peer, kept
from ..support.cpp_peer import Peer
from ..support.plc_calls import PACKAGE
from ..support.plc_demo import Memory
from .test_calls import CANCELED, NOTHING, SUCCEEDED, action, serve, srv  # noqa: F401
from .test_calls import program as cpp_program  # noqa: F401
from .test_calls import test_cpp_client as test_c_client  # noqa: F401
from .test_calls import test_cpp_client_sends_goals as test_c_client_sends_goals  # noqa: F401
from .test_calls import test_cpp_server_answers_a_plc as test_c_server_answers_a_plc  # noqa: F401
from .test_calls import test_cpp_server_executes_goals_of_python as test_c_server_executes_goals_of_python  # noqa: F401
from .test_calls import test_cpp_server_ignores_old_calls as test_c_server_ignores_old_calls  # noqa: F401

Scene = Callable[[Peer, Any, str], None]
SOURCES = {"c": "calls.c", "cpp": "calls.cpp"}


@pytest.fixture(scope="session")
def program(cpp_program: Path, generated: Path) -> Path:
    return cpp_peer.compiled(generated / "calls", "calls-c", cpp_peer.HERE / SOURCES["c"])


# --- rules for servers and clients, with Python as the peer ---------------------------------------------------


def check_old_call_is_ignored(peer: Peer, srv: Any, topic: str) -> None:
    """Ignore a call older than the server: another server may have served it."""
    with srv.AskClient(topic) as client:
        client.send(srv.Ask_Request(question=99))
        assert peer.ask(f"serve {topic} 20000") == "0"
        assert client.wait(0.3) is None
        assert client.call(srv.Ask_Request(question=1), timeout=20).answer == 4


def check_call_before_claim_is_ignored(peer: Peer, srv: Any, topic: str) -> None:
    """Ignore calls until the claim is certain. After a PLC server, that takes more than a second."""
    srv.AskServer(topic).close()
    Memory(topic, "-response")["writer"] = abi.PLC
    with srv.AskClient(topic) as client:
        peer.tell(f"serve {topic} 20000")
        time.sleep(0.5)
        client.send(srv.Ask_Request(question=99))
        assert peer.hear() == "0"
        assert client.wait(0.3) is None
        assert client.call(srv.Ask_Request(question=1), timeout=20).answer == 4


def check_response_to_other_is_ignored(peer: Peer, srv: Any, topic: str) -> None:
    assert peer.ask(f"client {topic}") == "0"
    with srv.AskServer(topic) as server:
        assert peer.ask("send 1 0") == "0"
        first_request = server.wait(20)
        assert peer.ask("send 2 0") == "0"
        assert server.reply(first_request, srv.Ask_Response(answer=4, copies=[4] * 16))
        assert peer.ask("poll") == str(NOTHING)
        assert server.reply(server.wait(20), srv.Ask_Response(answer=7, copies=[7] * 16))
        assert peer.ask("poll") == "0 7"


SCENES = {scene.__name__: scene for scene in (
    check_old_call_is_ignored, check_call_before_claim_is_ignored, check_response_to_other_is_ignored)}  # fmt: skip
FAULTS = {
    "old calls are served": (
        "check_old_call_is_ignored",
        "shmgen_server.h",
        "            shmgen_subscriber_skip(&self->requests);",
        "            (void)0;",
    ),
    "stale requests are skipped once": (
        "check_call_before_claim_is_ignored",
        "shmgen_server.h",
        "        if (self->responses.end.base == NULL || self->responses.end.step == SHMGEN_STEP_WATCH)",
        "        if (self->responses.end.base == NULL)",
    ),
    "the number is not compared": (
        "check_response_to_other_is_ignored",
        "shmgen_client.h",
        "self->number == 0 || head.number != self->number",
        "self->number == 0",
    ),
}


@pytest.mark.parametrize("scene", SCENES.values(), ids=SCENES)
@pytest.mark.parametrize("language", SOURCES)
def test_servers_and_clients_follow_the_rules(
    language: str,
    scene: Scene,
    program: Path,
    cpp_program: Path,
    srv: ModuleType,
    topic: str,
) -> None:
    with PeerProcess({"c": program, "cpp": cpp_program}[language]) as peer:
        scene(peer, srv, topic)


@pytest.mark.sample("-c]")
@pytest.mark.parametrize("language", SOURCES)
@pytest.mark.parametrize("fault", FAULTS)
def test_planted_fault_is_detected(
    fault: str,
    language: str,
    program: Path,
    generated: Path,
    srv: ModuleType,
    topic: str,
) -> None:
    scene, *edit = FAULTS[fault]
    program = build_faulty_program(generated / "calls", fault.replace(" ", "-"), language, *edit)
    with PeerProcess(program) as peer, pytest.raises(AssertionError):
        SCENES[scene](peer, srv, topic)


def build_faulty_program(folder: Path, name: str, language: str, header: str, right: str, wrong: str) -> Path:
    """Compile the program of a language with a fault in one of its headers."""
    copy = folder / name
    with kept.locked(folder / f"{name}.lock"):
        for root in ("c", "cpp") if not copy.exists() else ():
            shutil.copytree(folder / root, copy / root)
            path = copy / root / PACKAGE / header
            text = path.read_text()
            assert text.count(right) == 1
            path.write_text(text.replace(right, wrong))
    return cpp_peer.compiled(copy, f"calls-{language}", cpp_peer.HERE / SOURCES[language])


class PeerProcess:
    """A peer process that is killed at the end of the block."""

    def __init__(self, program: Path) -> None:
        self._program = program

    def __enter__(self) -> Peer:
        self._peer = Peer(self._program)
        return self._peer

    def __exit__(self, *_: object) -> None:
        self._peer.kill()
        self._peer.close()


@pytest.mark.parametrize("language", SOURCES)
def test_feedback_is_available_after_the_result(
    language: str,
    program: Path,
    cpp_program: Path,
    serve: Callable[[str, str], Any],
    topic: str,
) -> None:
    serve("python", "Count")
    with PeerProcess({"c": program, "cpp": cpp_program}[language]) as peer:
        assert peer.ask(f"goals {topic}") == "0"
        assert peer.ask("goal 3 1 20000") == "0"
        assert peer.ask("result 20000") == f"0 {SUCCEEDED} 3"
        assert peer.ask("progress") == "2 3"


@pytest.mark.parametrize("language", SOURCES)
def test_pending_goal_can_be_canceled(
    language: str,
    program: Path,
    cpp_program: Path,
    action: ModuleType,
    topic: str,
) -> None:
    with PeerProcess({"c": program, "cpp": cpp_program}[language]) as peer, action.CountActionClient(topic) as client:
        assert peer.ask(f"act {topic} 20000") == "0"
        for _ in range(20):
            client.send_goal(action.Count_Goal(target=10**9), timeout=20)
            client.send_goal(action.Count_Goal(target=10**9), timeout=20)
            client.cancel()
            assert client.result(timeout=20).status == CANCELED


@pytest.mark.slow
def test_oversized_request_or_response_ends_the_call(tmp_path: Path, topic: str) -> None:
    """End the call at once, whichever side sent the wrong count. Refuse invalid names."""
    lists = "uint8[<=4] codes\n---\nuint8[<=4] codes\n"
    cpp_peer.generate(tmp_path, {"put_msgs/srv/Put.srv": lists}, package="shm_refused", targets=("c",))
    program = cpp_peer.compiled(tmp_path, "refused", cpp_peer.HERE / "refused_calls.c")
    process = subprocess.run([program, topic], capture_output=True, text=True, timeout=60, check=False)
    assert (process.stdout, process.returncode) == ("", 0)
