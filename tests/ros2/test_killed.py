"""Test on one processor that data flows again after peers and the bridge are killed, and that PLC handlers call ROS."""

from __future__ import annotations

import os
import signal
from collections.abc import Iterator
from contextlib import suppress
from itertools import count
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest

from shmgen.live.classes import publisher, subscriber
from shmgen.runtime import ServiceClient

from ..support.ros1 import LIMIT, PROMPTLY, Peer, wait_for
from ..support.ros2 import Graph
from .test_bridge import SET_BOOL, plc_server, rclpy_only, session, set_bool, topic

BACKENDS = pytest.mark.parametrize(
    "graph", [("jazzy", "ros2"), ("kilted", "ros2"), ("jazzy", "dds")], indirect=True, ids="-".join
)
INT = "std_msgs/msg/Int32"


@pytest.fixture(autouse=True)
def one_processor() -> Iterator[None]:
    """One processor for this process and the processes that it starts."""
    processors = os.sched_getaffinity(0)
    os.sched_setaffinity(0, {min(processors)})
    yield
    os.sched_setaffinity(0, processors)


@pytest.fixture
def empty_ports() -> Iterator[int]:
    """A domain in which a killed node has left empty files of Fast DDS; no other test uses its number."""
    domain = 101
    files = [Path(f"/dev/shm/fastrtps_port{7400 + 250 * domain + port}") for port in range(40)]
    for file in files:
        file.write_bytes(b"")
    yield domain
    for file in files:
        file.unlink(missing_ok=True)


@pytest.mark.slow
@pytest.mark.parametrize("graph", ["jazzy"], indirect=True)
def test_sigterm_ends_a_bridge_blocked_in_fast_dds(graph: Graph, space: str, empty_ports: int) -> None:
    """Block Fast DDS with an empty file: it holds the GIL and waits until another process fills the file."""
    graph.number = empty_ports
    bridge = graph.bridge(f'source = "{graph.source}"\n' + topic(f"{space}/x", "std_msgs/Int32"), ready=False)
    bridge.wait_for_line(f"{space}/x")
    descriptors = Path(f"/proc/{bridge.process.pid}/fd")

    def has_the_file() -> bool:
        with suppress(FileNotFoundError):  # a descriptor was closed meanwhile
            return any("fastrtps_port" in os.readlink(descriptor) for descriptor in descriptors.iterdir())
        return False

    wait_for(has_the_file, "Fast DDS with the file")
    bridge.process.send_signal(signal.SIGTERM)
    assert bridge.process.wait(LIMIT) != 0
    bridge.wait_for_line("in create_node")


@pytest.mark.slow
@BACKENDS
def test_data_flows_again_after_kills(graph: Graph, space: str) -> None:
    to_plc, from_plc = f"{space}/there", f"{space}/back"
    config = f'source = "{graph.source}"\n' + topic(to_plc, "std_msgs/Int32") + topic(from_plc, "std_msgs/Int32")
    config += 'direction = "from_plc"\n'
    numbers = count(1)

    def check_flow(peer: Peer) -> None:
        """Check both directions with new numbers."""
        peer.ask(do="advertise", topic=to_plc, type=INT)
        peer.ask(do="subscribe", topic=from_plc, type=INT)
        first_number = next(numbers)

        def both_passed() -> bool:
            number = next(numbers)
            peer.ask(do="publish", topic=to_plc, messages=[{"data": number}])
            writer.publish(SimpleNamespace(data=number))
            sample = reader.wait(0.2)
            messages = peer.ask(do="take", topic=from_plc, count=1, timeout=0.2)
            passed["there"] |= sample is not None and sample.data > first_number
            passed["back"] |= bool(messages) and messages[0]["data"] > first_number
            return all(passed.values())

        passed = {"there": False, "back": False}
        wait_for(both_passed, "data", lambda: f"{passed} " + "".join(bridge.lines))

    bridge = graph.bridge(config)
    kind = session(graph).classes(["std_msgs/Int32"])[INT]
    with publisher(kind, from_plc, 1) as writer, subscriber(kind, to_plc, 1) as reader:
        first = graph.peer()
        check_flow(first)
        first.process.kill()
        second = graph.peer()
        check_flow(second)
        bridge.kill()
        bridge = graph.bridge()
        check_flow(second)
    assert bridge.stop(signal.SIGTERM) < PROMPTLY


@rclpy_only
def test_plc_handler_can_call_ros(graph: Graph, space: str) -> None:
    """Serve both calls in one bridge on one processor: a waiting call must not block the other call."""
    bridge = graph.bridge(
        f'source = "{graph.source}"\n'
        + SET_BOOL.format(space=space, server="plc", timeout=20)
        + SET_BOOL.format(space=f"{space}/of", server="ros", timeout=20)
    )
    client_peer, server_peer = graph.peer(), graph.peer()
    kind = "std_srvs/srv/SetBool"
    server_peer.ask(do="serve", service=f"{space}/of/flag", type=kind, answers=[{"success": True, "message": "of ROS"}])
    set_bool_client = set_bool(graph, ServiceClient)
    with set_bool_client(f"{space}/of/flag") as plc:

        def handler(request: Any) -> Any:
            return SimpleNamespace(success=True, message=f"the PLC heard: {plc.call(request, 15).message}")

        with plc_server(graph, f"{space}/flag", handler):
            arguments = {"service": f"{space}/flag", "type": kind, "request": {"data": True}, "timeout": 15}
            assert client_peer.ask(do="call", **arguments) == {"success": True, "message": "the PLC heard: of ROS"}
    assert bridge.stop(signal.SIGTERM) < PROMPTLY
