"""`shmgen bridge` over zenoh against PyPI's zenoh-ros2-sdk: values, losses, other definitions, calls, and deaths."""

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

from shmgen.live.classes import client, publisher, subscriber

from ..rigs.load_bridge import RATES, bridged
from ..ros2.test_bridge import SET_BOOL, call, monkeypatched, plc_server, session, topic
from ..support import import_or_skip, ros2
from ..support.ros1 import PROMPTLY, Peer, wait_for
from ..support.schemas import plain, random_message
from ..support.zenoh import Graph

import_or_skip("zenoh_ros2_sdk", reason="no zenoh-ros2-sdk: `make test` installs it where there is one")

ROW = "float64[] v\nstring name\nint32 n\nuint8[3] code\n"
FLAG = {"request_definition": "bool data", "response_definition": "bool success\nstring message"}
SETBOOL = {"type": "std_srvs/srv/SetBool", **FLAG}
NOT_OF_THE_SDK = {f"rmw_dds_common/msg/{name}" for name in ("NodeEntitiesInfo", "ParticipantEntitiesInfo")} | {
    f"type_description_interfaces/msg/{name}"
    for name in ("Field", "FieldType", "IndividualTypeDescription", "TypeDescription")
}
NOT_OF_THE_SDK |= {"test_msgs/msg/Strings"}
"""Its parser of definitions stops at them; and it has no wide strings."""


@pytest.fixture
def rows(graph: Graph) -> Graph:
    """A router, and a message of our own."""
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


def met(peer: Peer, token: str) -> None:
    """As soon as the peer sees a token that has this."""
    wait_for(lambda: [one for one in peer.ask(do="graph") if re.search(token, one)], token)


def row(number: int) -> dict[str, Any]:
    source = random.Random(number)
    v = [source.uniform(-9, 9) for _ in range(source.randrange(20))]
    return {"v": v, "name": f"n{number} é", "n": source.randrange(-(2**31), 2**31), "code": [number % 256, 7, 9]}


@pytest.mark.slow
def test_every_message_there_and_back(tmp_path: Path, space: str) -> None:
    """The SDK, the bridge, a region, the bridge, the SDK: unchanged. The hashes are ROS's own; it has some wrong."""
    prefix = ros2.prefix("jazzy")
    graph: Any = Graph(tmp_path, definitions=prefix / "share")
    graph.prefix, graph.environment["AMENT_PREFIX_PATH"], graph.environment["ROS_VERSION"] = prefix, str(prefix), "2"
    try:
        graph.router()
        config = 'source = "env"\n[types]\ntime = "struct"\n[strings]\ndefault = 40\n'
        found = (f"{file.parts[-3]}/msg/{file.stem}" for file in prefix.glob("share/*/msg/*.msg"))
        names = sorted(name for name in found if not re.search("builtin_interfaces|WStrings", name))
        assert len(names) > 120
        packages = sorted({name.split("/")[0] for name in names})
        config += "[bounds]\n" + "".join(f"{package} = 3\n" for package in packages)
        ends, hashes = list(enumerate(names)), ros2.hashes("jazzy")
        config += "".join(topic(f"{space}/there{number}", name) for number, name in ends)
        config += "".join(topic(f"{space}/back{number}", name, 'direction = "from_plc"') for number, name in ends)
        bridge, peer = graph.bridge(config), graph.peer()
        with monkeypatched(graph):
            made = session(graph)
            layouts, kinds = made.layouts(names), made.classes(names)
        wrong, left = [], set()
        for number, name in ends:
            there, back = f"{space}/there{number}", f"{space}/back{number}"
            if "failed" in peer.ask(do="advertise", topic=there, type=name, type_hash=hashes[name]):
                left.add(name)
                continue
            peer.ask(do="subscribe", topic=back, type=name, type_hash=hashes[name])
            assert peer.ask(do="connected", topic=there), name
            layout = next(layout for layout in layouts.values() if str(layout.name) == name)
            with ExitStack() as stack:
                reader = stack.enter_context(subscriber(kinds[name], there, 1))
                writer = stack.enter_context(publisher(kinds[name], back, 1))
                for seed in range(2):
                    values = plain(random_message(layout, layouts, random.Random(f"{name}{seed}")))
                    assert peer.ask(do="publish", topic=there, messages=[values]) is None, name
                    sample = reader.wait(10)
                    assert sample is not None, f"{name}\n{''.join(bridge.lines)}"
                    writer.publish(sample)
                    (came,) = peer.ask(do="take", topic=back, count=1) or [None]
                    if json.dumps(came) != json.dumps(values):
                        wrong.append((name, values, came))
        assert (wrong, left) == ([], NOT_OF_THE_SDK)
        bridge.stop(signal.SIGTERM)
    finally:
        graph.close()


@pytest.mark.slow
def test_a_thousand_a_second_each_way(rows: Graph, space: str) -> None:
    count = 2000
    bridge, peer = rows.bridge(both_ways(space)), rows.peer()
    peer.ask(do="advertise", topic=f"{space}/in", type="cell_msgs/msg/Row")
    peer.ask(do="subscribe", topic=f"{space}/out", type="cell_msgs/msg/Row")
    assert peer.ask(do="connected", topic=f"{space}/in")
    sent = [row(number) for number in range(count)]
    kind = session(rows).classes(["cell_msgs/Row"])["cell_msgs/msg/Row"]
    came: list[Any] = []
    over = threading.Event()
    with subscriber(kind, f"{space}/in", 255) as reader, publisher(kind, f"{space}/out", 255) as writer:

        def read() -> None:
            while not over.is_set():
                if reader.ready(0.05):
                    came.extend(
                        {"v": list(one.v), "name": one.name, "n": one.n, "code": list(one.code)}
                        for one in reader.read_all()
                    )

        thread = threading.Thread(target=read)
        thread.start()
        peer.ask(do="publish", topic=f"{space}/in", messages=sent, period=0.001)
        wait_for(lambda: len(came) + reader.missed >= count, "all", lambda: f"{len(came)} {reader.missed}")
        over.set()
        thread.join()
        assert came == sent
        begun = time.monotonic()
        for number, values in enumerate(sent):
            time.sleep(max(0.0, begun + number / 1000 - time.monotonic()))
            writer.publish(SimpleNamespace(**values))
        assert peer.ask(do="take", topic=f"{space}/out", count=count) == sent
    bridge.stop(signal.SIGTERM)
    bridge.wait_for_line(f"{space}/in +{count} passed$")
    bridge.wait_for_line(f"{space}/out +{count} passed$")


@pytest.mark.slow
def test_load(graph: Graph, space: str) -> None:
    """The load test of the bridge, short; `make load-bridge` is the long one."""
    graph.router()
    result = bridged(graph, f"{space}/load", 3)
    assert result.run.sent == 3 * sum(RATES.values())
    assert result.lost == 0


@pytest.mark.slow
def test_what_never_came_is_counted(rows: Graph, space: str) -> None:
    """Exactly, for each publisher."""
    bridge, peers = rows.bridge(both_ways(space)), [rows.peer(), rows.peer()]
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
def test_what_is_far_too_large_is_not_even_received(rows: Graph, space: str) -> None:
    """And counted as lost, as its number never comes."""
    bridge, peer = rows.bridge(both_ways(space)), rows.peer()
    peer.ask(do="advertise", topic=f"{space}/in", type="cell_msgs/msg/Row")
    assert peer.ask(do="connected", topic=f"{space}/in")
    for v in ([1.0], [1.0] * 1_000, [1.0] * 200_000, [2.0]):
        peer.ask(do="publish", topic=f"{space}/in", messages=[{**row(1), "v": v}])
    bridge.counted("2 passed, 1 rejected, 1 lost")


@pytest.mark.slow
def test_another_definition_is_refused_and_counted(rows: Graph, space: str) -> None:
    bridge, peer, other = rows.bridge(both_ways(space)), rows.peer(), rows.peer()
    for one, text in ((peer, ROW), (other, ROW.replace("int32 n", "float32 n"))):
        one.ask(do="advertise", topic=f"{space}/in", type="cell_msgs/msg/Row", msg_definition=text)
        one.ask(do="subscribe", topic=f"{space}/out", type="cell_msgs/msg/Row", msg_definition=text)
        assert one.ask(do="connected", topic=f"{space}/in")
        one.ask(do="publish", topic=f"{space}/in", messages=[row(1)] * 5)
    bridge.counted("5 passed, 5 refused")
    bridge.wait_for_line(f"{space}/in: a peer has another cell_msgs/Row: its type hash is RIHS01_")
    bridge.wait_for_line(
        f"{space}/out: a peer has another cell_msgs/Row: .*; no messages pass between it and the bridge"
    )
    bridge.stop(signal.SIGTERM)
    bridge = rows.bridge(both_ways(space, 'other_definition = "accept"'))
    assert other.ask(do="connected", topic=f"{space}/in")
    other.ask(do="publish", topic=f"{space}/in", messages=[row(1)] * 5)
    bridge.counted("5 passed")


def test_services_both_ways(graph: Graph, space: str) -> None:
    """Also of a client and a server that mean something else; one that is killed ends the call at once."""
    graph.router()
    of = f"{space}/of"
    services = SET_BOOL.format(space=space, server="plc", timeout=2) + SET_BOOL.format(
        space=of, server="ros", timeout=20
    )
    bridge, peer, other = graph.bridge(services), graph.peer(), graph.peer()
    kinds = session(graph).classes(["std_srvs/SetBool"])
    calling = client(kinds["std_srvs/srv/SetBool_Request"], kinds["std_srvs/srv/SetBool_Reply"])

    def handler(request: Any) -> Any:
        return SimpleNamespace(success=request.data, message="of the PLC")

    stranger = {**SETBOOL, "request_definition": "uint8 data"}
    with plc_server(graph, f"{space}/flag", handler), calling(f"{of}/flag") as plc:
        wait_for(lambda: peer.ask(do="call", service=f"{space}/flag", request={"data": True}, **SETBOOL), "a response")
        for data in (True, False):
            answer = peer.ask(do="call", service=f"{space}/flag", request={"data": data}, **SETBOOL)
            assert answer == {"success": data, "message": "of the PLC"}
        assert other.ask(do="call", service=f"{space}/flag", request={"data": 1}, timeout=1, **stranger) is None
        bridge.wait_for_line(f"{space}/flag: a peer has another std_srvs/SetBool")
        bridge.counted("1 refused")
        other.ask(do="serve", service=f"{of}/flag", answers=[], **stranger)
        wait_for(lambda: "no response" in call(plc) or "failed" in call(plc), "a failure")
        bridge.wait_for_line(f"{of}/flag: a peer has another std_srvs/SetBool")
        peer.ask(do="serve", service=f"{of}/flag", answers=[{"success": True, "message": "of ROS"}] * 2, **SETBOOL)
        wait_for(lambda: call(plc) == "of ROS", "an answer")
        dying = graph.peer()
        peer.process.kill()
        peer.process.wait()
        dying.ask(do="serve", service=f"{of}/flag", answers=[{}], delay=30, **SETBOOL)
        threading.Timer(2.5, dying.process.kill).start()

        def ended_early() -> bool:
            begun = time.monotonic()
            return "failed" in call(plc) and 1 < time.monotonic() - begun < 2.8

        wait_for(ended_early, "the end of a call whose server is killed", lambda: "".join(bridge.lines))
    assert bridge.stop(signal.SIGTERM) < PROMPTLY
    assert not [line for line in bridge.lines if "Error" in line or "panicked" in line]


@pytest.mark.slow
def test_the_end_comes_in_the_middle_of_calls(graph: Graph, space: str) -> None:
    """Each way; no thread of zenoh's ends the process as failed."""
    graph.router()
    of = f"{space}/of"
    services = SET_BOOL.format(space=space, server="plc", timeout=20) + SET_BOOL.format(
        space=of, server="ros", timeout=20
    )
    bridge, peer, other = graph.bridge(services), graph.peer(), graph.peer()
    other.ask(do="serve", service=f"{of}/flag", answers=[{}], delay=20, **SETBOOL)
    kinds = session(graph).classes(["std_srvs/SetBool"])
    calling = client(kinds["std_srvs/srv/SetBool_Request"], kinds["std_srvs/srv/SetBool_Reply"])
    came, ended = threading.Event(), threading.Event()

    def handler(request: Any) -> Any:
        came.set()
        ended.wait(20)
        return SimpleNamespace(success=True, message="")

    with plc_server(graph, f"{space}/flag", handler), calling(f"{of}/flag") as plc:
        asked = {"do": "call", "service": f"{space}/flag", "request": {"data": True}, "timeout": 20, **SETBOOL}
        met(peer, f"/SS/.*shmgen_bridge/{space.replace('/', '%')}%flag/")
        threading.Thread(target=lambda: peer.ask(**asked), daemon=True).start()
        threading.Thread(target=lambda: call(plc), daemon=True).start()
        assert came.wait(20)
        time.sleep(0.5)
        took = bridge.stop(signal.SIGTERM)
        ended.set()
    assert took < PROMPTLY
    assert not [line for line in bridge.lines if "rror" in line or "panicked" in line or "Traceback" in line]


def test_who_comes_late_hears_the_newest(rows: Graph, space: str) -> None:
    """Both ways, and of publishers that keep what they said as rmw_zenoh has them do it."""
    state, told = f"{space}_state", f"{space}/told"  # the SDK asks for no name with a slash within
    config = topic(state, "std_msgs/Int32", 'direction = "from_plc"', "latch = true", "depth = 60")
    config += topic(told, "std_msgs/Int32", "latch = true")
    int32 = {"type": "std_msgs/msg/Int32", "msg_definition": "int32 data"}
    early = rows.peer()
    early.ask(do="advertise", topic=told, **int32)
    early.ask(do="keep", topic=told, messages=[{"data": 1}, {"data": 2}])
    bridge = rows.bridge(config)
    kind = session(rows).classes(["std_msgs/Int32"])["std_msgs/msg/Int32"]
    with publisher(kind, state, 60) as writer, subscriber(kind, told, 1) as reader:
        wait_for(lambda: (sample := reader.read()) and sample.data == 2, "what was said before")
        for number in range(50):
            writer.publish(SimpleNamespace(data=number))
        bridge.counted(f"{state} +50 passed")
        peer = rows.peer()
        met(peer, f"/MP/.*/shmgen_bridge/{state.replace('/', '%')}/")  # it asks once for what was said
        peer.ask(do="subscribe", topic=state, latch=True, **int32)
        assert peer.ask(do="take", topic=state, count=1) == [{"data": 49}]
        assert peer.ask(do="take", topic=state, count=1, timeout=0.2) == []
    bridge.stop(signal.SIGTERM)
    bridge.wait_for_line(f"{told} +1 passed$")


@pytest.mark.slow
def test_router_bridge_and_peer_die_and_return(graph: Graph, space: str) -> None:
    """And the bridge is there before the router."""
    int32 = {"type": "std_msgs/msg/Int32", "msg_definition": "int32 data"}
    bridge = graph.bridge(topic(f"{space}/x", "std_msgs/Int32"))
    bridge.wait_for_line("zenoh: no router at .* yet; start one: `ros2 run rmw_zenoh_cpp rmw_zenohd`")
    kind = session(graph).classes(["std_msgs/Int32"])["std_msgs/msg/Int32"]
    numbers = iter(range(100_000))

    def flows(peer: Any) -> None:
        assert peer.ask(do="connected", topic=f"{space}/x")
        with subscriber(kind, f"{space}/x", 1) as reader:

            def crossed() -> bool:
                peer.ask(do="publish", topic=f"{space}/x", messages=[{"data": next(numbers)}])
                return reader.read() is not None

            wait_for(crossed, "a message", lambda: "".join(bridge.lines))

    router, peer = graph.router(), graph.peer()
    peer.ask(do="advertise", topic=f"{space}/x", **int32)
    flows(peer)
    bridge.kill()
    bridge = graph.bridge()
    flows(peer)
    peer.process.kill()
    router.kill()
    router.wait()
    graph.router()
    peer = graph.peer()
    peer.ask(do="advertise", topic=f"{space}/x", **int32)
    flows(peer)
    assert bridge.stop(signal.SIGINT) < PROMPTLY


def test_the_graph_knows_us(rows: Graph, space: str) -> None:
    """Our tokens are what the SDK makes of the same; a namespace is a part of names."""
    name = f"{space}/in".replace("/", "%")
    bridge, peer = rows.bridge(both_ways(space)), rows.peer()
    peer.ask(do="subscribe", topic=f"{space}/in", type="cell_msgs/msg/Row")
    met(peer, "/NN/%/%/shmgen_bridge$")

    def of_both() -> tuple[list[Any], list[Any]] | None:
        """The tokens of the topic, once an answer has them: one answer may lack some."""
        ours, theirs = [], []
        for token in peer.ask(do="graph"):
            parts = token.split("/")
            if len(parts) == 13 and parts[9] == name:
                (ours if parts[8] == "shmgen_bridge" else theirs).append([*parts[:2], parts[5], *parts[9:12]])
        return (ours, theirs) if ours and theirs else None

    ours, theirs = wait_for(of_both, "the tokens of both")
    assert len(ours) == 1
    assert ours == theirs
    bridge.stop(signal.SIGTERM)


@pytest.mark.parametrize(
    ("variable", "value", "why"),
    [
        ("ZENOH_SESSION_CONFIG_URI", "/nowhere.json5", "ZENOH_SESSION_CONFIG_URI is '/nowhere.json5'"),
        ("ZENOH_CONFIG_OVERRIDE", "mode=1", "ZENOH_CONFIG_OVERRIDE has 'mode=1'"),
        ("ROS_DOMAIN_ID", "x", "a domain is a number from 0 to 232, not 'x' as ROS_DOMAIN_ID says"),
    ],
)
def test_what_can_never_work_is_said(graph: Graph, space: str, variable: str, value: str, why: str) -> None:
    graph.environment[variable] = value
    bridge = graph.bridge(topic(f"{space}/x", "std_msgs/Int32"), ready=False)
    assert bridge.process.wait(30) == 1
    bridge.wait_for_line(rf"zenoh: error\[SHM\d+\]: {why}")
    bridge.wait_for_line("  hint: correct this argument, setting or variable, and start the bridge again")
    assert "SHM901" not in "".join(bridge.lines)
