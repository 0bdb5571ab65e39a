"""Test `shmgen bridge` over zenoh with PyPI's zenoh-ros2-sdk: values, losses, definitions, calls, killed processes."""

from __future__ import annotations

import json
import random
import re
import signal
import threading
import time
from contextlib import ExitStack
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest

from shmgen.live.classes import publisher, subscriber
from shmgen.runtime import ServiceClient

from ..rigs.load_bridge import RATES, bridged
from ..ros2.test_bridge import SET_BOOL, call, plc_server, ros_environment, session, set_bool, topic
from ..support import import_or_skip, ros2
from ..support.ros1 import PROMPTLY, Peer, wait_for
from ..support.schemas import plain, random_message
from ..support.zenoh import Graph

import_or_skip("zenoh_ros2_sdk", reason="no zenoh-ros2-sdk: `make test` installs it where there is one")

ROW = "float64[] v\nstring name\nint32 n\nuint8[3] code\n"
FLAG = {"request_definition": "bool data", "response_definition": "bool success\nstring message"}
SETBOOL = {"type": "std_srvs/srv/SetBool", **FLAG}
UNSUPPORTED_BY_SDK = {f"rmw_dds_common/msg/{name}" for name in ("NodeEntitiesInfo", "ParticipantEntitiesInfo")} | {
    f"type_description_interfaces/msg/{name}"
    for name in ("Field", "FieldType", "IndividualTypeDescription", "TypeDescription")
}
UNSUPPORTED_BY_SDK |= {"test_msgs/msg/Strings"}
"""Types that the SDK does not support: its parser rejects the definitions, or they contain wide strings."""


@pytest.fixture
def cell(graph: Graph) -> Graph:
    """A graph with a router and the message type cell_msgs/Row."""
    file = graph.definitions / "cell_msgs" / "msg" / "Row.msg"
    file.parent.mkdir(parents=True)
    file.write_text(ROW)
    graph.router()
    return graph


def both_ways(space: str, *keys: str) -> str:
    return (
        'path = ["msgs"]\n[bounds]\ncell_msgs = 64\n'
        + topic(f"{space}/in", "cell_msgs/Row", "depth = 255", *keys)
        + topic(f"{space}/out", "cell_msgs/Row", "depth = 255", 'direction = "from_plc"')
    )


def wait_for_token(peer: Peer, pattern: str) -> None:
    """Wait until the peer sees a token that matches the pattern."""
    wait_for(lambda: [token for token in peer.ask(do="graph") if re.search(pattern, token)], pattern)


def row(number: int) -> dict[str, Any]:
    source = random.Random(number)
    v = [source.uniform(-9, 9) for _ in range(source.randrange(20))]
    return {"v": v, "name": f"n{number} é", "n": source.randrange(-(2**31), 2**31), "code": [number % 256, 7, 9]}


@pytest.mark.slow
def test_every_message_type_passes_both_ways_unchanged(tmp_path: Path, space: str) -> None:
    """Pass each type from the SDK to a region and back. Use ROS's type hashes, because some of the SDK's are wrong."""
    prefix = ros2.prefix("jazzy")
    graph: Any = Graph(tmp_path, definitions=prefix / "share")
    graph.prefix, graph.environment["AMENT_PREFIX_PATH"], graph.environment["ROS_VERSION"] = prefix, str(prefix), "2"
    try:
        graph.router()
        config = 'source = "env"\n[types]\ntime = "struct"\n[strings]\ndefault = 40\n'
        types = (f"{file.parts[-3]}/msg/{file.stem}" for file in prefix.glob("share/*/msg/*.msg"))
        names = sorted(name for name in types if not re.search("builtin_interfaces|WStrings", name))
        assert len(names) > 120
        packages = sorted({name.split("/")[0] for name in names})
        config += "[bounds]\n" + "".join(f"{package} = 3\n" for package in packages)
        pairs, hashes = list(enumerate(names)), ros2.hashes("jazzy")
        config += "".join(topic(f"{space}/there{number}", name) for number, name in pairs)
        config += "".join(topic(f"{space}/back{number}", name, 'direction = "from_plc"') for number, name in pairs)
        bridge, peer = graph.bridge(config), graph.peer()
        with ros_environment(graph):
            schema_session = session(graph)
            layouts, kinds = schema_session.layouts(names), schema_session.classes(names)
        wrong, unsupported = [], set()
        for number, name in pairs:
            to_plc, from_plc = f"{space}/there{number}", f"{space}/back{number}"
            if "failed" in peer.ask(do="advertise", topic=to_plc, type=name, type_hash=hashes[name]):
                unsupported.add(name)
                continue
            peer.ask(do="subscribe", topic=from_plc, type=name, type_hash=hashes[name])
            assert peer.ask(do="connected", topic=to_plc), name
            layout = next(layout for layout in layouts.values() if str(layout.name) == name)
            with ExitStack() as stack:
                reader = stack.enter_context(subscriber(kinds[name], to_plc, 1))
                writer = stack.enter_context(publisher(kinds[name], from_plc, 1))
                for seed in range(2):
                    values = plain(random_message(layout, layouts, random.Random(f"{name}{seed}")))
                    assert peer.ask(do="publish", topic=to_plc, messages=[values]) is None, name
                    sample = reader.wait(10)
                    assert sample is not None, f"{name}\n{''.join(bridge.lines)}"
                    writer.publish(sample)
                    (received,) = peer.ask(do="take", topic=from_plc, count=1) or [None]
                    if json.dumps(received) != json.dumps(values):
                        wrong.append((name, values, received))
        assert (wrong, unsupported) == ([], UNSUPPORTED_BY_SDK)
        bridge.stop(signal.SIGTERM)
    finally:
        graph.close()


@pytest.mark.slow
def test_thousand_messages_per_second_pass_each_way(cell: Graph, space: str) -> None:
    count = 2000
    bridge, peer = cell.bridge(both_ways(space)), cell.peer()
    peer.ask(do="advertise", topic=f"{space}/in", type="cell_msgs/msg/Row")
    peer.ask(do="subscribe", topic=f"{space}/out", type="cell_msgs/msg/Row")
    assert peer.ask(do="connected", topic=f"{space}/in")
    sent = [row(number) for number in range(count)]
    kind = session(cell).classes(["cell_msgs/Row"])["cell_msgs/msg/Row"]
    received: list[Any] = []
    stop = threading.Event()
    with subscriber(kind, f"{space}/in", 255) as reader, publisher(kind, f"{space}/out", 255) as writer:

        def read() -> None:
            while not stop.is_set():
                if reader.ready(0.05):
                    received.extend(
                        {"v": list(sample.v), "name": sample.name, "n": sample.n, "code": list(sample.code)}
                        for sample in reader.read_all()
                    )

        thread = threading.Thread(target=read)
        thread.start()
        peer.ask(do="publish", topic=f"{space}/in", messages=sent, period=0.001)
        wait_for(lambda: len(received) + reader.missed >= count, "all", lambda: f"{len(received)} {reader.missed}")
        stop.set()
        thread.join()
        assert received == sent
        started_at = time.monotonic()
        for number, values in enumerate(sent):
            time.sleep(max(0.0, started_at + number / 1000 - time.monotonic()))
            writer.publish(SimpleNamespace(**values))
        assert peer.ask(do="take", topic=f"{space}/out", count=count) == sent
    bridge.stop(signal.SIGTERM)
    bridge.wait_for_line(f"{space}/in +{count} passed$")
    bridge.wait_for_line(f"{space}/out +{count} passed$")


@pytest.mark.slow
def test_short_load_run_counts_every_lost_message(graph: Graph, space: str) -> None:
    """Run the load test of `make load-bridge` for 3 s."""
    graph.router()
    result = bridged(graph, f"{space}/load", 3)
    assert result.run.sent == 3 * sum(RATES.values())
    assert result.lost == 0


@pytest.mark.slow
def test_lost_messages_are_counted_for_each_publisher(cell: Graph, space: str) -> None:
    bridge, peers = cell.bridge(both_ways(space)), [cell.peer(), cell.peer()]
    for peer in peers:
        peer.ask(do="advertise", topic=f"{space}/in", type="cell_msgs/msg/Row")
        assert peer.ask(do="connected", topic=f"{space}/in")
    for gap in (0, 3, 0, 4):
        for peer in peers:
            peer.ask(do="skip", topic=f"{space}/in", count=gap)
            peer.ask(do="publish", topic=f"{space}/in", messages=[row(1)] * 2)
    peers[0].ask(do="publish_raw", topic=f"{space}/in", messages=["00010000ffffffff"])
    bridge.counted("16 passed, 1 rejected, 14 lost")


@pytest.mark.slow
def test_far_too_large_message_is_dropped_as_lost(cell: Graph, space: str) -> None:
    """Count it as lost, because its sequence number is missing."""
    bridge, peer = cell.bridge(both_ways(space)), cell.peer()
    peer.ask(do="advertise", topic=f"{space}/in", type="cell_msgs/msg/Row")
    assert peer.ask(do="connected", topic=f"{space}/in")
    for v in ([1.0], [1.0] * 1_000, [1.0] * 200_000, [2.0]):
        peer.ask(do="publish", topic=f"{space}/in", messages=[{**row(1), "v": v}])
    bridge.counted("2 passed, 1 rejected, 1 lost")


@pytest.mark.slow
def test_messages_of_another_definition_are_refused_and_counted(cell: Graph, space: str) -> None:
    bridge, peer, other = cell.bridge(both_ways(space)), cell.peer(), cell.peer()
    for node, text in ((peer, ROW), (other, ROW.replace("int32 n", "float32 n"))):
        node.ask(do="advertise", topic=f"{space}/in", type="cell_msgs/msg/Row", msg_definition=text)
        node.ask(do="subscribe", topic=f"{space}/out", type="cell_msgs/msg/Row", msg_definition=text)
        assert node.ask(do="connected", topic=f"{space}/in")
        node.ask(do="publish", topic=f"{space}/in", messages=[row(1)] * 5)
    bridge.counted("5 passed, 5 refused")
    bridge.wait_for_line(f"{space}/in: a peer uses another definition of cell_msgs/Row: its type hash is RIHS01_")
    bridge.wait_for_line(
        f"{space}/out: .* another definition of cell_msgs/Row.*; no messages pass between it and the bridge"
    )
    bridge.stop(signal.SIGTERM)
    bridge = cell.bridge(both_ways(space, 'other_definition = "accept"'))
    assert other.ask(do="connected", topic=f"{space}/in")
    other.ask(do="publish", topic=f"{space}/in", messages=[row(1)] * 5)
    bridge.counted("5 passed")


def test_services_pass_both_ways(graph: Graph, space: str) -> None:
    """Refuse a client and a server with another definition. End a call at once when its server is killed."""
    graph.router()
    ros = f"{space}/of"
    services = SET_BOOL.format(space=space, server="plc", timeout=2) + SET_BOOL.format(
        space=ros, server="ros", timeout=20
    )
    bridge, peer, other = graph.bridge(services), graph.peer(), graph.peer()
    set_bool_client = set_bool(graph, ServiceClient)

    def handler(request: Any) -> Any:
        return SimpleNamespace(success=request.data, message="of the PLC")

    wrong_type = {**SETBOOL, "request_definition": "uint8 data"}
    with plc_server(graph, f"{space}/flag", handler), set_bool_client(f"{ros}/flag") as plc:
        wait_for(lambda: peer.ask(do="call", service=f"{space}/flag", request={"data": True}, **SETBOOL), "a response")
        for data in (True, False):
            answer = peer.ask(do="call", service=f"{space}/flag", request={"data": data}, **SETBOOL)
            assert answer == {"success": data, "message": "of the PLC"}
        assert other.ask(do="call", service=f"{space}/flag", request={"data": 1}, timeout=1, **wrong_type) is None
        bridge.wait_for_line(f"{space}/flag: a peer uses another definition of std_srvs/SetBool")
        bridge.counted("1 refused")
        other.ask(do="serve", service=f"{ros}/flag", answers=[], **wrong_type)
        wait_for(lambda: "no response" in call(plc) or "failed" in call(plc), "a failure")
        bridge.wait_for_line(f"{ros}/flag: a peer uses another definition of std_srvs/SetBool")
        peer.ask(do="serve", service=f"{ros}/flag", answers=[{"success": True, "message": "of ROS"}] * 2, **SETBOOL)
        wait_for(lambda: call(plc) == "of ROS", "an answer")
        killed_peer = graph.peer()
        peer.process.kill()
        peer.process.wait()
        killed_peer.ask(do="serve", service=f"{ros}/flag", answers=[{}], delay=30, **SETBOOL)
        threading.Timer(2.5, killed_peer.process.kill).start()

        def call_ended_early() -> bool:
            started_at = time.monotonic()
            return "failed" in call(plc) and 1 < time.monotonic() - started_at < 2.8

        wait_for(call_ended_early, "the end of a call whose server is killed", lambda: "".join(bridge.lines))
    assert bridge.stop(signal.SIGTERM) < PROMPTLY
    assert not [line for line in bridge.lines if "Error" in line or "panicked" in line]


@pytest.mark.slow
def test_bridge_stops_promptly_during_calls(graph: Graph, space: str) -> None:
    """Stop during a call to the PLC and a call to ROS, without an error from zenoh's threads."""
    graph.router()
    ros = f"{space}/of"
    services = SET_BOOL.format(space=space, server="plc", timeout=20) + SET_BOOL.format(
        space=ros, server="ros", timeout=20
    )
    bridge, peer, other = graph.bridge(services), graph.peer(), graph.peer()
    other.ask(do="serve", service=f"{ros}/flag", answers=[{}], delay=20, **SETBOOL)
    set_bool_client = set_bool(graph, ServiceClient)
    request_received, ended = threading.Event(), threading.Event()

    def handler(request: Any) -> Any:
        request_received.set()
        ended.wait(20)
        return SimpleNamespace(success=True, message="")

    with plc_server(graph, f"{space}/flag", handler), set_bool_client(f"{ros}/flag") as plc:
        command = {"do": "call", "service": f"{space}/flag", "request": {"data": True}, "timeout": 20, **SETBOOL}
        wait_for_token(peer, f"/SS/.*shmgen_bridge/{space.replace('/', '%')}%flag/")
        threading.Thread(target=lambda: peer.ask(**command), daemon=True).start()
        threading.Thread(target=lambda: call(plc), daemon=True).start()
        assert request_received.wait(20)
        time.sleep(0.5)
        duration = bridge.stop(signal.SIGTERM)
        ended.set()
    assert duration < PROMPTLY
    assert not [line for line in bridge.lines if "rror" in line or "panicked" in line or "Traceback" in line]


def test_late_subscriber_receives_the_newest_message(cell: Graph, space: str) -> None:
    """Pass the newest message of a latched topic both ways. The ROS publisher keeps messages as rmw_zenoh's do."""
    state, latched = f"{space}_state", f"{space}/told"  # the SDK cannot query a name that contains a slash
    config = topic(state, "std_msgs/Int32", 'direction = "from_plc"', "latch = true", "depth = 60")
    config += topic(latched, "std_msgs/Int32", "latch = true")
    int32 = {"type": "std_msgs/msg/Int32", "msg_definition": "int32 data"}
    early = cell.peer()
    early.ask(do="advertise", topic=latched, **int32)
    early.ask(do="keep", topic=latched, messages=[{"data": 1}, {"data": 2}])
    bridge = cell.bridge(config)
    kind = session(cell).classes(["std_msgs/Int32"])["std_msgs/msg/Int32"]
    with publisher(kind, state, 60) as writer, subscriber(kind, latched, 1) as reader:
        wait_for(lambda: (sample := reader.read()) and sample.data == 2, "what was said before")
        for number in range(50):
            writer.publish(SimpleNamespace(data=number))
        bridge.counted(f"{state} +50 passed")
        peer = cell.peer()
        wait_for_token(peer, f"/MP/.*/shmgen_bridge/{state.replace('/', '%')}/")  # the SDK queries once
        peer.ask(do="subscribe", topic=state, latch=True, **int32)
        assert peer.ask(do="take", topic=state, count=1) == [{"data": 49}]
        assert peer.ask(do="take", topic=state, count=1, timeout=0.2) == []
    bridge.stop(signal.SIGTERM)
    bridge.wait_for_line(f"{latched} +1 passed$")


@pytest.mark.slow
def test_messages_flow_again_after_router_bridge_and_peer_restart(graph: Graph, space: str) -> None:
    """Start the bridge also before the router runs."""
    int32 = {"type": "std_msgs/msg/Int32", "msg_definition": "int32 data"}
    bridge = graph.bridge(topic(f"{space}/x", "std_msgs/Int32"))
    bridge.wait_for_line("zenoh: no router runs at .*; start one: `ros2 run rmw_zenoh_cpp rmw_zenohd`")
    kind = session(graph).classes(["std_msgs/Int32"])["std_msgs/msg/Int32"]
    numbers = iter(range(100_000))

    def check_flow(peer: Any) -> None:
        assert peer.ask(do="connected", topic=f"{space}/x")
        with subscriber(kind, f"{space}/x", 1) as reader:

            def message_passed() -> bool:
                peer.ask(do="publish", topic=f"{space}/x", messages=[{"data": next(numbers)}])
                return reader.read() is not None

            wait_for(message_passed, "a message", lambda: "".join(bridge.lines))

    router, peer = graph.router(), graph.peer()
    peer.ask(do="advertise", topic=f"{space}/x", **int32)
    check_flow(peer)
    bridge.kill()
    bridge = graph.bridge()
    check_flow(peer)
    peer.process.kill()
    router.kill()
    router.wait()
    graph.router()
    peer = graph.peer()
    peer.ask(do="advertise", topic=f"{space}/x", **int32)
    check_flow(peer)
    assert bridge.stop(signal.SIGINT) < PROMPTLY


def test_subscriber_token_equals_that_of_the_sdk(cell: Graph, space: str) -> None:
    """Announce a subscriber with the token that the SDK uses. A namespace is part of the name."""
    name = f"{space}/in".replace("/", "%")
    bridge, peer = cell.bridge(both_ways(space)), cell.peer()
    peer.ask(do="subscribe", topic=f"{space}/in", type="cell_msgs/msg/Row")
    wait_for_token(peer, "/NN/%/%/shmgen_bridge$")

    def topic_tokens() -> tuple[list[Any], list[Any]] | None:
        """Return the topic's tokens of bridge and SDK, or None if this reply lacks some."""
        ours, theirs = [], []
        for token in peer.ask(do="graph"):
            parts = token.split("/")
            if len(parts) == 13 and parts[9] == name:
                (ours if parts[8] == "shmgen_bridge" else theirs).append([*parts[:2], parts[5], *parts[9:12]])
        return (ours, theirs) if ours and theirs else None

    ours, theirs = wait_for(topic_tokens, "the tokens of both")
    assert len(ours) == 1
    assert ours == theirs
    bridge.stop(signal.SIGTERM)


@pytest.mark.parametrize(
    ("variable", "value", "why"),
    [
        ("ZENOH_SESSION_CONFIG_URI", "/nowhere.json5", "ZENOH_SESSION_CONFIG_URI is '/nowhere.json5'"),
        ("ZENOH_CONFIG_OVERRIDE", "mode=1", "ZENOH_CONFIG_OVERRIDE has 'mode=1'"),
        ("ROS_DOMAIN_ID", "x", "the domain in ROS_DOMAIN_ID must be a number from 0 to 232, not 'x'"),
    ],
)
def test_invalid_environment_variable_ends_the_bridge(
    graph: Graph, space: str, variable: str, value: str, why: str
) -> None:
    graph.environment[variable] = value
    bridge = graph.bridge(topic(f"{space}/x", "std_msgs/Int32"), ready=False)
    assert bridge.process.wait(30) == 1
    bridge.wait_for_line(rf"zenoh: error\[SHM\d+\]: {why}")
    bridge.wait_for_line("  hint: correct this argument, setting or variable, and start the bridge again")
    assert "SHM901" not in "".join(bridge.lines)
