"""A DDS domain on loopback for each worker, and its peers."""

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

from ..bridge import contract
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
"""The types that the peers have: nested, stamped, with strings, arrays, and bounded and unbounded sequences."""


class WithoutCyclone(pytest.Module):
    """A test file that is skipped because this machine has no wheel of cyclonedds."""

    def collect(self) -> NoReturn:
        pytest.skip("no cyclonedds here", allow_module_level=True)


def pytest_pycollect_makemodule(module_path: Path, parent: pytest.Collector) -> pytest.Module | None:
    cyclonedds = importlib.util.find_spec("cyclonedds")
    return None if cyclonedds else WithoutCyclone.from_parent(parent, path=module_path)


@pytest.fixture(scope="session")
def schema() -> Schema:
    return pipeline.read(Config(Path.cwd()), TYPES)


@pytest.fixture(scope="session")
def domain(testrun_uid: str, worker_id: str) -> int:
    """A domain number for each worker, from the numbers whose ports Linux assigns to no other socket."""
    number = int(worker_id.removeprefix("gw")) if worker_id.startswith("gw") else 0
    return 1 + (zlib.crc32(testrun_uid.encode()) + number) % 100


@pytest.fixture(autouse=True)
def _loopback(monkeypatch: pytest.MonkeyPatch, domain: int) -> None:
    monkeypatch.setenv("CYCLONEDDS_URI", LOOPBACK)
    monkeypatch.setenv("ROS_DOMAIN_ID", str(domain))


@pytest.fixture
def cell(domain: int, tmp_path: Path, topic: str) -> Iterator[Domain]:
    """A domain with bridges and other processes. They end before the region of `topic` is removed."""
    cell_domain = Domain(tmp_path, domain)
    yield cell_domain
    cell_domain.close()


@pytest.fixture
def logged() -> list[str]:
    """The list of messages that the backend logs."""
    return []


@pytest.fixture
def graph(logged: list[str]) -> Iterator[Graph]:
    """The bridge's node in the domain."""
    from shmgen.bridge.dds import backend

    node = backend.connect(Node("shmgen_test", None, logged.append, lambda: False, largest=2**20))
    yield node
    node.close()


@pytest.fixture(scope="session", params=[pytest.param("fast", marks=pytest.mark.slow), "cyclone"])
def peer(request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory, schema: Schema) -> Path:
    """A program of another vendor, built once for all workers."""
    if tool := peers.missing(request.param):
        pytest.skip(f"no {tool} to build a peer with")
    shared = tmp_path_factory.getbasetemp()
    if "PYTEST_XDIST_WORKER" in os.environ:
        shared = shared.parent
    topics = [message.name for message in schema.messages if message.name in schema.requested]
    return peers.build(request.param, shared / "dds_peers", schema.messages, topics)


class Errors(contract.Errors):
    """An ErrorSink that appends reports to `logged` and counts lost messages in `lost`."""

    lost = 0

    def lose(self, count: int) -> None:
        self.lost += count


def wire(schema: Schema, topic: str, request: str, **how: Any) -> Wire:
    """Return a topic as the bridge describes it to the backend."""
    name = next(message.name for message in schema.messages if message.name.short == request)
    return Wire(topic, closure(schema, name), **how)


def until(true: Callable[[], Any], seconds: float = 60) -> None:
    """Wait until `true()` returns True. Poll ten times in a second."""
    deadline = time.monotonic() + seconds
    while not true():
        assert time.monotonic() < deadline, f"not within {seconds} s"
        time.sleep(0.1)
