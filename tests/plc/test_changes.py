"""A message changes in a running plant: one side after the other is killed, updated and started, and nobody types rm.

One of three writes, a PLC, the engine in C or the reference in Python; the others read. Clients and servers change too.
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
OTHERWISE = (["LayoutMismatch"], ["DIGEST_MISMATCH"])
"""What an end says that has another version than the writer."""
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
    """An end in Python; `said` are its lines so far."""

    def __init__(self, folder: Path, package: str, side: str, topic: str, pure: bool) -> None:
        environment = {**os.environ, "SHMGEN_PURE": "1"} if pure else dict(os.environ)
        self._log = (folder / f"{package}-{side}-{time.monotonic_ns()}.log").open("w+b")
        command = [sys.executable, "-c", END, str(folder / "python"), package, side, topic]
        self._process = subprocess.Popen(command, env=environment, stdout=self._log)

    @property
    def said(self) -> list[str]:
        return Path(self._log.name).read_text().split()

    def cycle(self) -> None:
        assert self._process.poll() is None

    def kill(self) -> None:
        self._process.kill()
        self._process.wait()
        self._log.close()


class Block:
    """The same in a PLC, which the test calls; killed, it lets go of nothing."""

    def __init__(self, plc: Plc, side: str, topic: str) -> None:
        self._block = plc.block(f"FB_plant_msgs_State_{'Publisher' if side == 'writer' else 'Subscriber'}")
        self._block.xEnable, self._block.sTopic = True, topic
        self._writes = side == "writer"
        self.said: list[str] = []
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
            self._say("got" if whole else "torn")
        elif done or block.xError:
            self._say("published" if done else block.eErrorID)

    def _say(self, text: str) -> None:
        if self.said[-1:] != [text]:
            self.said.append(text)

    def kill(self) -> None:
        pass


@pytest.fixture(scope="module")
def versions(tmp_path_factory: pytest.TempPathFactory) -> dict[int, tuple[Path, Plc]]:
    made = {}
    for version, text in VERSIONS.items():
        folder = tmp_path_factory.mktemp(f"plant{version}")
        services = call_ends.definitions("float64 more\n" if version == 2 else "")
        put({"plant_msgs/msg/State.msg": text, **services}, folder / "definitions")
        config = Config(folder, path=(folder / "definitions",), package=f"shm_v{version}")
        texts = pipeline.generate(config, ["plant_msgs/State", "plant_msgs/Ask", "plant_msgs/Count"])
        put(texts, folder)
        st = {path: text for path, text in texts.items() if path.endswith(".st")}
        made[version] = folder, compile_st(st, folder / "plc")
    return made


def plans() -> Iterator[Any]:
    for writer, order in itertools.product(KINDS, itertools.permutations(KINDS)):
        yield pytest.param(writer, order, id=f"{writer}-writes-{'-'.join(order)}")


@pytest.mark.parametrize(("writer", "order"), [*plans()])
def test_one_side_after_the_other_is_updated(
    versions: dict[int, tuple[Path, Plc]], topic: str, writer: str, order: tuple[str, ...]
) -> None:
    ends: dict[str, tuple[int, Process | Block]] = {}
    with ExitStack() as stack:

        def start(kind: str, version: int) -> None:
            folder, plc = versions[version]
            side = "writer" if kind == writer else "reader"
            made = (
                Block(plc, side, topic)
                if kind == "plc"
                else Process(folder, f"shm_v{version}", side, topic, kind == "pure")
            )
            stack.callback(made.kill)
            ends[kind] = version, made

        def settles() -> None:
            """Who writes is heard by all of its version, and told of by the others; or it cannot yet, and says so."""
            deadline = time.monotonic() + 20 * slower
            while not settled():
                assert time.monotonic() < deadline, {kind: end.said for kind, (_, end) in ends.items()}
                for _, end in ends.values():
                    end.cycle()
                time.sleep(0.002)

        def settled() -> bool:
            now, writes = ends[writer]
            if writes.said[-1:] != ["published"]:
                # A PLC removes nothing: it waits until the last of the others is updated, which replaces the region.
                return writes.said[-1:] == ["DIGEST_MISMATCH"] and any(version != now for version, _ in ends.values())
            others = [ends[kind] for kind in KINDS if kind != writer]
            return all(end.said[-1:] in ((["got"],) if version == now else OTHERWISE) for version, end in others)

        for kind in KINDS:
            start(kind, 1)
        settles()
        for kind in order:
            ends[kind][1].kill()
            start(kind, 2)
            settles()
        assert all("torn" not in end.said for _, end in ends.values())


def package_of(versions: dict[int, tuple[Path, Plc]], version: int, monkeypatch: pytest.MonkeyPatch) -> ModuleType:
    """The generated package of a version, with its services and actions."""
    monkeypatch.syspath_prepend(str(versions[version][0] / "python"))
    for kind in ("srv", "action"):
        importlib.import_module(f"shm_v{version}.plant_msgs.{kind}")
    return importlib.import_module(f"shm_v{version}.plant_msgs")


@pytest.mark.parametrize("acts", [False, True], ids=["service", "action"])
@pytest.mark.parametrize("server", KINDS)
@pytest.mark.parametrize(
    ("client", "change"),
    [
        *((kind, change) for kind in ("c", "pure") for change in ("updated", "removed")),
        ("plc", "removed"),  # a PLC replaces no region, so its update waits for another end's
    ],
)
def test_no_client_gets_the_response_to_a_former_call(
    versions: dict[int, tuple[Path, Plc]],
    topic: str,
    monkeypatch: pytest.MonkeyPatch,
    client: str,
    change: str,
    server: str,
    acts: bool,
) -> None:
    """The server still works on the first call of the request region when a new client begins in a fresh one."""

    def client_of(version: int) -> PlcClient | PythonClient:
        if client == "plc":
            return PlcClient(versions[version][1], topic, acts)
        return PythonClient(package_of(versions, version, monkeypatch), topic, acts, client == "pure")

    def server_of(version: int) -> PlcServer | PythonServer:
        if server == "plc":
            return PlcServer(versions[version][1], topic, acts)
        return PythonServer(package_of(versions, version, monkeypatch), topic, acts, server == "pure")

    old, serving = client_of(1), server_of(1)
    old.send(1)
    until(serving.takes)
    old.stop()
    if change == "removed":
        Path(region_file(region_name(f"{topic}-goal" if acts else f"{topic}-request"))).unlink()
    new = client_of(2 if change == "updated" else 1)
    new.send(2)
    serving.respond()
    for _ in range(20):
        assert new.response() is None
    serving.stop()
    new.stop()
