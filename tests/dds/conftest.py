"""What the tests of DDS share: a domain of their own on loopback, and the peers."""

from __future__ import annotations

import importlib.util
import os
import time
import zlib
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import TYPE_CHECKING, Any, NoReturn

import pytest

from shmgen.bridge.backend import Node, Wire
from shmgen.bridge.plan import closure
from shmgen.config import Config
from shmgen.core.model import Schema
from shmgen.generator import pipeline

from ..support.dds import LOOPBACK, Domain
from . import peers

if TYPE_CHECKING:
    from shmgen.bridge.dds.backend import Graph

TYPES = (
    "diagnostic_msgs/DiagnosticArray",
    "geometry_msgs/Pose",
    "geometry_msgs/PoseStamped",
    "sensor_msgs/BatteryState",
    "sensor_msgs/Imu",
    "sensor_msgs/JointState",
    "shape_msgs/SolidPrimitive",
    "std_msgs/ByteMultiArray",
    "std_msgs/Empty",
    "std_msgs/String",
    "trajectory_msgs/JointTrajectory",
)
"""Those the peers know: nested, stamped, with strings, arrays, bounded and unbounded sequences of all of these."""


class WithoutCyclone(pytest.Module):
    """A file of tests on a machine that has no wheel of cyclonedds."""

    def collect(self) -> NoReturn:
        pytest.skip("no cyclonedds here", allow_module_level=True)


def pytest_pycollect_makemodule(module_path: Path, parent: pytest.Collector) -> pytest.Module | None:
    found = importlib.util.find_spec("cyclonedds")
    return None if found else WithoutCyclone.from_parent(parent, path=module_path)


@pytest.fixture(scope="session")
def schema() -> Schema:
    return pipeline.read(Config(Path.cwd()), TYPES)


@pytest.fixture(scope="session")
def domain(testrun_uid: str, worker_id: str) -> int:
    """One for each worker, out of those whose ports Linux gives to nobody else."""
    number = int(worker_id.removeprefix("gw")) if worker_id.startswith("gw") else 0
    return 1 + (zlib.crc32(testrun_uid.encode()) + number) % 100


@pytest.fixture(autouse=True)
def _loopback(monkeypatch: pytest.MonkeyPatch, domain: int) -> None:
    monkeypatch.setenv("CYCLONEDDS_URI", LOOPBACK)
    monkeypatch.setenv("ROS_DOMAIN_ID", str(domain))


@pytest.fixture
def cell(domain: int, tmp_path: Path, topic: str) -> Iterator[Domain]:
    """Where bridges and other processes are. They end before the region of `topic` goes: a bridge makes it anew."""
    made = Domain(tmp_path, domain)
    yield made
    made.close()


@pytest.fixture
def told() -> list[str]:
    """What the backend tells whoever watches."""
    return []


@pytest.fixture
def graph(told: list[str]) -> Iterator[Graph]:
    """Our node in the domain."""
    from shmgen.bridge.dds import backend

    made = backend.connect(Node("shmgen_test", None, told.append, lambda: False, largest=2**20))
    yield made
    made.close()


@pytest.fixture(scope="session", params=["fast", "cyclone"])
def peer(request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory, schema: Schema) -> Path:
    """A program that is not ours, built once for all workers."""
    if tool := peers.missing(request.param):
        pytest.skip(f"no {tool} to build a peer with")
    shared = tmp_path_factory.getbasetemp()
    if "PYTEST_XDIST_WORKER" in os.environ:
        shared = shared.parent
    topics = [message.name for message in schema.messages if message.name in schema.requested]
    return peers.build(request.param, shared / "dds_peers", schema.messages, topics)


class Taken:
    """A MessageSink: messages go to `take`; the rest is `told`."""

    def __init__(self, take: Callable[[Any], Any], told: list[str] | None = None) -> None:
        self.take = take
        self.told = [] if told is None else told
        self.lost = 0

    def reject(self, why: str) -> None:
        self.told.append(why)

    def refuse(self, why: str) -> None:
        self.told.append(why)

    def meet(self, stranger: str) -> None:
        self.told += [stranger] if stranger else []

    def lose(self, count: int) -> None:
        self.lost += count


def wire(schema: Schema, topic: str, request: str, **how: Any) -> Wire:
    """The topic as the bridge would describe it to the backend."""
    name = next(message.name for message in schema.messages if message.name.short == request)
    return Wire(topic, closure(schema, name), **how)


def until(true: Callable[[], Any], seconds: float = 10) -> None:
    """Returns as soon as `true()` is, asked ten times a second."""
    deadline = time.monotonic() + seconds
    while not true():
        assert time.monotonic() < deadline, f"not within {seconds} s"
        time.sleep(0.1)
