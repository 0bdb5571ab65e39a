"""Programs in a running plant are killed, updated and started one by one after a message changed. Nobody types rm.

A PLC, the engine in C or the reference in Python writes, and the other two read. Clients and servers change too.
"""

from __future__ import annotations

import importlib
import itertools
import os
import subprocess
import sys
import time
from collections.abc import Iterator
from contextlib import ExitStack
from pathlib import Path
from types import ModuleType
from typing import Any

import pytest

from shmgen.config import Config
from shmgen.generator import pipeline
from shmgen.runtime.region.names import region_file, region_name
from tests.softplc import Plc, compile_st

from ..support import call_ends
from ..support.build import put
from ..support.call_ends import PlcClient, PlcServer, PythonClient, PythonServer, until
from ..support.machine import slower

pytestmark = pytest.mark.slow  # two PLCs are translated and compiled
VERSIONS = {1: "uint32 a\n", 2: "uint32 a\nfloat64[4] b\n"}
KINDS = ("plc", "c", "pure")
MISMATCHES = (["LayoutMismatch"], ["DIGEST_MISMATCH"])
"""The reports of an end whose version of the message differs from the writer's version."""
END = r"""
import sys, time
folder, package, side, topic = sys.argv[1:]
sys.path.insert(0, folder)
from shmgen.runtime import ShmError
messages = __import__(f"{package}.plant_msgs.msg", fromlist=["msg"])
said = None

def say(text):
    global said
    if text != said:
        print(text, flush=True)
        said = text

number = 0
while True:
    try:
        if side == "writer":
            with messages.StatePublisher(topic) as publisher:
                while True:
                    number += 1
                    message = messages.State(a=number)
                    if hasattr(message, "b"):
                        message.b = [number / 2] * 4
                    publisher.publish(message)
                    publisher.heartbeat()
                    say("published")
                    time.sleep(0.005)
        with messages.StateSubscriber(topic) as subscriber:
            while True:
                if message := subscriber.wait(0.1):
                    whole = list(getattr(message, "b", [message.a / 2] * 4)) == [message.a / 2] * 4
                    say("got" if whole else "torn")
    except ShmError as error:
        say(type(error).__name__)
        time.sleep(0.02)
"""


class Process:
    """An end in Python. `log` contains the lines that the process has printed."""

    def __init__(self, folder: Path, package: str, side: str, topic: str, pure: bool) -> None:
        environment = {**os.environ, "SHMGEN_PURE": "1"} if pure else dict(os.environ)
        self._log = (folder / f"{package}-{side}-{time.monotonic_ns()}.log").open("w+b")
        command = [sys.executable, "-c", END, str(folder / "python"), package, side, topic]
        self._process = subprocess.Popen(command, env=environment, stdout=self._log)

    @property
    def log(self) -> list[str]:
        return Path(self._log.name).read_text().split()

    def cycle(self) -> None:
        assert self._process.poll() is None

    def kill(self) -> None:
        self._process.kill()
        self._process.wait()
        self._log.close()


class Block:
    """An end in a PLC, which the test calls. kill() releases nothing."""

    def __init__(self, plc: Plc, side: str, topic: str) -> None:
        self._block = plc.block(f"FB_plant_msgs_State_{'Publisher' if side == 'writer' else 'Subscriber'}")
        self._block.xEnable, self._block.sTopic = True, topic
        self._writes = side == "writer"
        self.log: list[str] = []
        self._number = 0

    def cycle(self) -> None:
        block = self._block
        if self._writes:
            self._number += 1
            block.Msg.a = self._number
            for at in range(4 if hasattr(block.Msg, "b") else 0):
                block.Msg.b[at] = self._number / 2
            block.xSend = True
        block()
        done = block.xSent if self._writes else block.xNewData
        if done and not self._writes:
            whole = all(one == block.Msg.a / 2 for one in getattr(block.Msg, "b", ()))
            self._report("got" if whole else "torn")
        elif done or block.xError:
            self._report("published" if done else block.eErrorID)

    def _report(self, text: str) -> None:
        if self.log[-1:] != [text]:
            self.log.append(text)

    def kill(self) -> None:
        pass


@pytest.fixture(scope="module")
def versions(tmp_path_factory: pytest.TempPathFactory) -> dict[int, tuple[Path, Plc]]:
    programs = {}
    for version, text in VERSIONS.items():
        folder = tmp_path_factory.mktemp(f"plant{version}")
        services = call_ends.definitions("float64 more\n" if version == 2 else "")
        put({"plant_msgs/msg/State.msg": text, **services}, folder / "definitions")
        config = Config(folder, path=(folder / "definitions",), package=f"shm_v{version}")
        texts = pipeline.generate(config, ["plant_msgs/State", "plant_msgs/Ask", "plant_msgs/Count"])
        put(texts, folder)
        st = {path: text for path, text in texts.items() if path.endswith(".st")}
        programs[version] = folder, compile_st(st, folder / "plc")
    return programs


def plans() -> Iterator[Any]:
    for writer, order in itertools.product(KINDS, itertools.permutations(KINDS)):
        yield pytest.param(writer, order, id=f"{writer}-writes-{'-'.join(order)}")


@pytest.mark.parametrize(("writer", "order"), [*plans()])
def test_programs_updated_one_by_one_connect_again(
    versions: dict[int, tuple[Path, Plc]], topic: str, writer: str, order: tuple[str, ...]
) -> None:
    ends: dict[str, tuple[int, Process | Block]] = {}
    with ExitStack() as stack:

        def start(kind: str, version: int) -> None:
            folder, plc = versions[version]
            side = "writer" if kind == writer else "reader"
            end = (
                Block(plc, side, topic)
                if kind == "plc"
                else Process(folder, f"shm_v{version}", side, topic, kind == "pure")
            )
            stack.callback(end.kill)
            ends[kind] = version, end

        def wait_until_settled() -> None:
            """Wait until the writer's version gets samples and other versions report a mismatch, or the writer does."""
            deadline = time.monotonic() + 20 * slower
            while not is_settled():
                assert time.monotonic() < deadline, {kind: end.log for kind, (_, end) in ends.items()}
                for _, end in ends.values():
                    end.cycle()
                time.sleep(0.002)

        def is_settled() -> bool:
            now, source = ends[writer]
            if source.log[-1:] != ["published"]:
                # A PLC removes nothing: it waits until the last of the others is updated, which replaces the region.
                return source.log[-1:] == ["DIGEST_MISMATCH"] and any(version != now for version, _ in ends.values())
            others = [ends[kind] for kind in KINDS if kind != writer]
            return all(end.log[-1:] in ((["got"],) if version == now else MISMATCHES) for version, end in others)

        for kind in KINDS:
            start(kind, 1)
        wait_until_settled()
        for kind in order:
            ends[kind][1].kill()
            start(kind, 2)
            wait_until_settled()
        assert all("torn" not in end.log for _, end in ends.values())


def package_of(versions: dict[int, tuple[Path, Plc]], version: int, monkeypatch: pytest.MonkeyPatch) -> ModuleType:
    """Import the generated package of a version, with its services and actions."""
    monkeypatch.syspath_prepend(str(versions[version][0] / "python"))
    for kind in ("srv", "action"):
        importlib.import_module(f"shm_v{version}.plant_msgs.{kind}")
    return importlib.import_module(f"shm_v{version}.plant_msgs")


@pytest.mark.parametrize("is_action", [False, True], ids=["service", "action"])
@pytest.mark.parametrize("server", KINDS)
@pytest.mark.parametrize(
    ("client", "change"),
    [
        *((kind, change) for kind in ("c", "pure") for change in ("updated", "removed")),
        ("plc", "removed"),  # a PLC replaces no region, so its update waits for that of another end
    ],
)
def test_no_client_gets_the_response_to_a_former_call(
    versions: dict[int, tuple[Path, Plc]],
    topic: str,
    monkeypatch: pytest.MonkeyPatch,
    client: str,
    change: str,
    server: str,
    is_action: bool,
) -> None:
    """Start a client in a new request region while the server still executes a call of the former region."""

    def client_of(version: int) -> PlcClient | PythonClient:
        if client == "plc":
            return PlcClient(versions[version][1], topic, is_action)
        return PythonClient(package_of(versions, version, monkeypatch), topic, is_action, client == "pure")

    def server_of(version: int) -> PlcServer | PythonServer:
        if server == "plc":
            return PlcServer(versions[version][1], topic, is_action)
        return PythonServer(package_of(versions, version, monkeypatch), topic, is_action, server == "pure")

    old, active_server = client_of(1), server_of(1)
    old.send(1)
    until(active_server.takes)
    old.stop()
    if change == "removed":
        Path(region_file(region_name(f"{topic}-goal" if is_action else f"{topic}-request"))).unlink()
    new = client_of(2 if change == "updated" else 1)
    new.send(2)
    active_server.respond()
    for _ in range(20):
        assert new.response() is None
    active_server.stop()
    new.stop()
