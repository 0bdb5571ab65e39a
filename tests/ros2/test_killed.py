"""On a machine of one processor: peers and the bridge are killed, a PLC's handler calls ROS, and data flows again."""

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

from shmgen.live.classes import client, publisher, subscriber

from ..support.ros1 import LIMIT, PROMPTLY, Peer, wait_for
from ..support.ros2 import Graph
from .test_bridge import SET_BOOL, by_rclpy, plc_server, session, topic

SOME_WAYS = pytest.mark.parametrize(
    "graph", [("jazzy", "ros2"), ("kilted", "ros2"), ("jazzy", "dds")], indirect=True, ids="-".join
)
INT = "std_msgs/msg/Int32"


@pytest.fixture(autouse=True)
def one_processor() -> Iterator[None]:
    """For all that is started meanwhile, and for us."""
    all_there = os.sched_getaffinity(0)
    os.sched_setaffinity(0, {min(all_there)})
    yield
    os.sched_setaffinity(0, all_there)


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
def test_sigterm_ends_a_bridge_that_fast_dds_blocks(graph: Graph, space: str, empty_ports: int) -> None:
    """Fast DDS waits without limit until another process fills the file. Meanwhile it holds Python's lock."""
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
@SOME_WAYS
def test_data_flows_again(graph: Graph, space: str) -> None:
    there, back = f"{space}/there", f"{space}/back"
    config = f'source = "{graph.source}"\n' + topic(there, "std_msgs/Int32") + topic(back, "std_msgs/Int32")
    config += 'direction = "from_plc"\n'
    numbers = count(1)

    def flows(peer: Peer) -> None:
        """Both ways, with numbers that nobody has sent before."""
        peer.ask(do="advertise", topic=there, type=INT)
        peer.ask(do="subscribe", topic=back, type=INT)
        since = next(numbers)

        def crossed() -> bool:
            number = next(numbers)
            peer.ask(do="publish", topic=there, messages=[{"data": number}])
            writer.publish(SimpleNamespace(data=number))
            came = reader.wait(0.2)
            heard = peer.ask(do="take", topic=back, count=1, timeout=0.2)
            done["there"] |= came is not None and came.data > since
            done["back"] |= bool(heard) and heard[0]["data"] > since
            return all(done.values())

        done = {"there": False, "back": False}
        wait_for(crossed, "data", lambda: f"{done} " + "".join(bridge.lines))

    bridge = graph.bridge(config)
    kind = session(graph).classes(["std_msgs/Int32"])[INT]
    with publisher(kind, back, 1) as writer, subscriber(kind, there, 1) as reader:
        first = graph.peer()
        flows(first)
        first.process.kill()
        second = graph.peer()
        flows(second)
        bridge.kill()
        bridge = graph.bridge()
        flows(second)
    assert bridge.stop(signal.SIGTERM) < PROMPTLY


@by_rclpy
def test_a_handler_of_the_plc_calls_ros(graph: Graph, space: str) -> None:
    """Both calls are of one bridge, which has one processor and still waits for none of them in another's place."""
    bridge = graph.bridge(
        f'source = "{graph.source}"\n'
        + SET_BOOL.format(space=space, server="plc", timeout=20)
        + SET_BOOL.format(space=f"{space}/of", server="ros", timeout=20)
    )
    asking, answering = graph.peer(), graph.peer()
    kind = "std_srvs/srv/SetBool"
    answering.ask(do="serve", service=f"{space}/of/flag", type=kind, answers=[{"success": True, "message": "of ROS"}])
    kinds = session(graph).classes(["std_srvs/SetBool"])
    calling = client(kinds["std_srvs/srv/SetBool_Request"], kinds["std_srvs/srv/SetBool_Reply"])
    with calling(f"{space}/of/flag") as plc:

        def handler(request: Any) -> Any:
            return SimpleNamespace(success=True, message=f"the PLC heard: {plc.call(request, 15).message}")

        with plc_server(graph, f"{space}/flag", handler):
            asked = {"service": f"{space}/flag", "type": kind, "request": {"data": True}, "timeout": 15}
            assert asking.ask(do="call", **asked) == {"success": True, "message": "the PLC heard: of ROS"}
    assert bridge.stop(signal.SIGTERM) < PROMPTLY
