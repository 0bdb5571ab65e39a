"""Test services in the formats of rmw_cyclonedds and Fast DDS, mostly against peers built from plain topics."""

from __future__ import annotations

import os
import re
import sys
import threading
import time
import zlib
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest
from cyclonedds.domain import DomainParticipant
from cyclonedds.idl import make_idl_struct, types
from cyclonedds.pub import DataWriter
from cyclonedds.qos import Policy, Qos
from cyclonedds.sub import DataReader
from cyclonedds.topic import Topic

from shmgen.bridge.backend import LARGEST, NoAnswer, Node, ServiceWire
from shmgen.bridge.dds import backend
from shmgen.bridge.dds.network import network
from shmgen.bridge.dds.service_pair import Direction, ReceivedCall
from shmgen.config import Config
from shmgen.generator import pipeline

from ..support.dds import this_machine, without_fast_dds
from .conftest import Errors, until

SERVICE = "int64 number\nstring word\n---\nbool success\nstring message\n"
NAMES = ("Ask_Request", "Ask_Response")
HEAD = {"client_guid_": types.uint64, "sequence_number_": types.int64}
REQUEST = make_idl_struct("Q", "cell_msgs::srv::dds_::Ask_Request_", {**HEAD, "number_": types.int64, "word_": str})
REPLY = make_idl_struct("A", "cell_msgs::srv::dds_::Ask_Response_", {**HEAD, "success_": bool, "message_": str})
"""The layout of serdata.cpp in rmw_cyclonedds: 16 bytes of header, then the message."""


@pytest.fixture(scope="session")
def domain(testrun_uid: str, worker_id: str) -> int:
    """A domain apart from that of the other test files, because a process can configure a Cyclone domain only once."""
    number = int(worker_id.removeprefix("gw")) if worker_id.startswith("gw") else 0
    return 1 + (zlib.crc32(testrun_uid.encode()) + number + 25) % 100


@pytest.fixture(autouse=True, params=["cyclone", "fast"])
def way(request: pytest.FixtureRequest, monkeypatch: pytest.MonkeyPatch) -> None:
    """The service backend: Cyclone by RMW_IMPLEMENTATION or because shmgen-fastdds is unusable, or Fast DDS."""
    if request.param == "cyclone":
        monkeypatch.setenv("RMW_IMPLEMENTATION", "rmw_cyclonedds_cpp")
    if request.param == "no package":
        monkeypatch.setitem(sys.modules, "shmgen_fastdds", None)
    if request.param == "another":
        monkeypatch.setitem(sys.modules, "shmgen_fastdds", SimpleNamespace(Fast=raise_missing_library))
    if request.param == "fast":
        without_fast_dds()
    monkeypatch.setenv("ROS_AUTOMATIC_DISCOVERY_RANGE", "LOCALHOST")
    monkeypatch.setenv("CYCLONEDDS_URI", this_machine())


def raise_missing_library(*_: Any) -> None:
    raise OSError("libfastrtps.so.2.9: cannot open shared object file: No such file or directory")


@pytest.fixture
def wire(tmp_path: Path, topic: str) -> ServiceWire:
    file = tmp_path / "cell_msgs" / "srv" / "Ask.srv"
    file.parent.mkdir(parents=True)
    file.write_text(SERVICE)
    messages = pipeline.read(Config(Path.cwd(), path=(tmp_path,)), ["cell_msgs/Ask"]).messages
    request, response = ([message for message in messages if message.name.name == name] for name in NAMES)
    return ServiceWire(topic, tuple(request), tuple(response))


class PeerSide:
    """A peer's side of the service: a reader of one topic and a writer of the other.

    If it is not `known`, its user data is empty, like that of a peer on rmw_fastrtps.
    """

    def __init__(
        self, domain: int, service: str, role: str, known: bool = True, user_data: str = "", reads: bool = True
    ) -> None:
        is_server = role == "serviceid"
        self.participant = DomainParticipant(domain)
        request = Topic(self.participant, f"rq{service}Request", REQUEST)
        reply = Topic(self.participant, f"rr{service}Reply", REPLY)
        policies = [Policy.Reliability.Reliable(10**9), Policy.History.KeepLast(10)]
        qos = Qos(*policies, *([Policy.Userdata(f"{role}=1.a.ff;{user_data}".encode())] if known else []))
        self.create_reader = lambda: DataReader(self.participant, request if is_server else reply, qos)
        if reads:
            self.reader = self.create_reader()
        self.writer = DataWriter(self.participant, reply if is_server else request, qos)

    def matched(self) -> bool:
        return bool(self.writer.get_matched_subscriptions() and self.reader.get_matched_publications())


def service_lines(logged: list[str]) -> list[str]:
    """Leave out the lines about the domain."""
    return [line for line in logged if line.startswith("/")]


def test_client_receives_the_reply_to_its_call(graph: backend.Graph, domain: int, wire: ServiceWire) -> None:
    def answer(request: Any, response: Any) -> None:
        if request.number < 0:
            raise NoAnswer("the PLC is in stop")
        response.success, response.message = True, f"{request.word} {request.number}"

    graph.serve(wire, answer, Errors())
    client = PeerSide(domain, wire.name, "clientid")
    until(client.matched)
    client.writer.write(REQUEST(2**63 + 1, 7, -1, "lost"))
    client.writer.write(REQUEST(2**63 + 1, 8, 2**40, "grün"))
    reply = client.reader.take_one(timeout=20 * 10**9)
    assert reply == REPLY(2**63 + 1, 8, True, f"grün {2**40}")


def test_reply_waits_until_the_reader_is_known(graph: backend.Graph, domain: int, wire: ServiceWire) -> None:
    """Keep the reply, because discovery may report a client's writer some time before its reader."""
    request_received = threading.Event()
    graph.serve(wire, lambda request, response: request_received.set(), Errors())
    client = PeerSide(domain, wire.name, "clientid", reads=False)
    until(client.writer.get_matched_subscriptions, 20)
    client.writer.write(REQUEST(1, 9, 0, ""))
    assert request_received.wait(20)
    time.sleep(0.3)
    client.reader = client.create_reader()
    assert client.reader.take_one(timeout=20 * 10**9) == REPLY(1, 9, False, "")


def test_failed_call_is_logged(graph: backend.Graph, domain: int, wire: ServiceWire, logged: list[str]) -> None:
    def answer(request: Any, response: Any) -> None:
        raise NoAnswer("the PLC is in stop")

    graph.serve(wire, answer, Errors())
    client = PeerSide(domain, wire.name, "clientid")
    until(client.matched)
    client.writer.write(REQUEST(1, 1, 1, ""))
    until(lambda: logged[-1] == f"{wire.name}: no answer: the PLC is in stop", 20)


def test_client_ignores_replies_to_other_calls(graph: backend.Graph, domain: int, wire: ServiceWire) -> None:
    caller = graph.client(wire)
    server = PeerSide(domain, wire.name, "serviceid")
    until(server.matched, 20)

    def serve() -> None:
        for _ in range(3):
            request = server.reader.take_one(timeout=20 * 10**9)
            head = request.client_guid_, request.sequence_number_
            server.writer.write(REPLY(head[0] ^ 1, head[1], False, "for another client"))
            server.writer.write(REPLY(head[0], head[1] + 1, False, "for another call"))
            server.writer.write(REPLY(*head, True, request.word_ * request.number_))

    thread = threading.Thread(target=serve)
    thread.start()
    for number in (1, 2, 3):
        request = caller.new()
        request.number, request.word = number, "a"
        response = caller.call(request, 20.0)
        assert (response.success, response.message) == (True, "a" * number)
    thread.join()


@pytest.mark.parametrize("has_server", [False, True], ids=["no server", "no answer"])
def test_call_without_answer_times_out(graph: backend.Graph, domain: int, wire: ServiceWire, has_server: bool) -> None:
    caller = graph.client(wire)
    server = PeerSide(domain, wire.name, "serviceid") if has_server else None
    started_at = time.monotonic()
    with pytest.raises(NoAnswer, match="no answer within 1 s" if server else "no server within 1 s"):
        caller.call(caller.new(), 1.0)
    assert 0.9 < time.monotonic() - started_at < 5


def test_bridge_calls_its_own_service(graph: backend.Graph, wire: ServiceWire) -> None:
    graph.serve(wire, lambda request, response: setattr(response, "message", request.word), Errors())
    caller = graph.client(wire)
    request = caller.new()
    request.word = "echo"
    assert caller.call(request, 20.0).message == "echo"


def test_removed_service_leaves_the_graph(graph: backend.Graph, domain: int, wire: ServiceWire) -> None:
    """Remove the service as a reload does, then add it again."""
    client = PeerSide(domain, wire.name, "clientid")
    for answer in ("before", "again"):
        graph.undo = []
        graph.serve(wire, lambda request, response, word=answer: setattr(response, "message", word), Errors())
        until(client.matched, 20)
        client.writer.write(REQUEST(1, 1, 1, ""))
        assert client.reader.take_one(timeout=20 * 10**9).message_ == answer
        for undo in graph.undo:
            undo()
        until(lambda: not client.writer.get_matched_subscriptions(), 20)
        until(lambda: not client.reader.get_matched_publications(), 20)


ANOTHER = f"typehash=RIHS01_{'1' * 64};"


def test_client_of_another_definition_does_not_reach_the_plc(
    graph: backend.Graph, domain: int, wire: ServiceWire, logged: list[str]
) -> None:
    refused: list[str] = []
    graph.serve(wire, lambda request, response: logged.append("answered"), Errors(refused))
    client = PeerSide(domain, wire.name, "clientid", user_data=ANOTHER)
    until(client.matched)
    client.writer.write(REQUEST(1, 1, 1, ""))
    until(lambda: len(refused) >= 2)
    (line,) = service_lines(logged)
    assert f"{wire.name}: a peer uses another definition of cell_msgs/Ask_Request: its type hash is RIHS01_1" in line


def test_server_of_another_definition_is_not_called(graph: backend.Graph, domain: int, wire: ServiceWire) -> None:
    caller = graph.client(wire)
    server = PeerSide(domain, wire.name, "serviceid", user_data=ANOTHER)
    until(server.matched)
    with pytest.raises(NoAnswer, match="another definition of cell_msgs/Ask_Request"):
        caller.call(caller.new(), 1.0)
    assert not server.reader.take(1)


without_fast = pytest.mark.parametrize("way", ["cyclone", "no package", "another"], indirect=True)


@without_fast
def test_client_of_another_middleware_does_not_reach_the_plc(
    graph: backend.Graph, domain: int, wire: ServiceWire, logged: list[str]
) -> None:
    refused: list[str] = []
    graph.serve(wire, lambda request, response: logged.append("answered"), Errors(refused))
    client = PeerSide(domain, wire.name, "clientid", known=False)
    until(client.matched)
    client.writer.write(REQUEST(1, 1, 1, ""))
    until(lambda: len(refused) >= 2)
    (line,) = [line for line in service_lines(logged) if "rmw_cyclonedds" in line]
    before, _, hint = line.partition("no messages pass between it and the bridge; ")
    assert before == f"{wire.name}: a peer does not use rmw_cyclonedds: "
    if "RMW_IMPLEMENTATION" not in os.environ:
        assert re.match(r"install shmgen-fastdds (where .*|again \(libfastrtps.so.2.9: .*)\), or start the peer", hint)
    assert hint.endswith("the peer with RMW_IMPLEMENTATION=rmw_cyclonedds_cpp, or the bridge with --backend ros2")


@pytest.mark.parametrize("way", ["fast"], indirect=True)
def test_malformed_request_is_refused(graph: backend.Graph, domain: int, wire: ServiceWire, logged: list[str]) -> None:
    """Refuse a request with rmw_cyclonedds's header from a client that announces no client id."""
    refused: list[str] = []
    graph.serve(wire, lambda request, response: logged.append("answered"), Errors(refused))
    client = PeerSide(domain, wire.name, "clientid", known=False)
    until(client.matched, 20)
    client.writer.write(REQUEST(1, 1, 1, ""))
    until(lambda: refused, 20)
    assert any("CDR message size mismatch" in line for line in service_lines(logged))
    assert "answered" not in logged


@without_fast
def test_server_of_another_middleware_is_not_called(graph: backend.Graph, domain: int, wire: ServiceWire) -> None:
    caller = graph.client(wire)
    server = PeerSide(domain, wire.name, "serviceid", known=False)
    until(server.matched)
    with pytest.raises(NoAnswer, match="a peer does not use rmw_cyclonedds"):
        caller.call(caller.new(), 1.0)
    assert not server.reader.take(1)


@pytest.mark.parametrize("way", ["fast"], indirect=True)
def test_servers_of_both_middlewares_are_not_called(graph: backend.Graph, domain: int, wire: ServiceWire) -> None:
    caller = graph.client(wire)
    servers = [PeerSide(domain, wire.name, "serviceid", known=known) for known in (True, False)]
    why = "one would misread the request"

    def is_refused() -> bool:
        try:
            caller.call(caller.new(), 0.2)
        except NoAnswer as error:
            return why in str(error)
        return False

    until(is_refused, 20)
    for server in servers:
        server.reader.take(100)  # requests from before both servers were discovered
    with pytest.raises(NoAnswer, match=why):
        caller.call(caller.new(), 5.0)
    assert [server.reader.take(1) for server in servers] == [[], []]


@pytest.mark.parametrize("way", ["fast"], indirect=True)
def test_fast_dds_matches_replies_and_leaves_nothing(domain: int, topic: str) -> None:
    """Match replies that name the client's reader, or its writer as older versions do. Leave no thread, file or map."""

    def resources() -> set[str]:
        folders = ("/proc/self/task", "/proc/self/fd")
        maps = Path("/proc/self/maps").read_text().split()  # not /dev/shm itself, where other processes create files
        return {f"{folder}/{name}" for folder in folders for name in os.listdir(folder)} | {
            word for word in maps if word.startswith("/dev/shm/")
        }

    def side(name: str) -> Direction:
        return Direction(name, "cell_msgs::srv::dds_::Ask_", object, "typehash=;")

    def reply(call: ReceivedCall) -> None:
        older = call.cdr.endswith(b"older")
        serving.send(call.cdr * 2, call.sender + call.call[16:] if older else call.call)

    from shmgen_fastdds import Fast

    logged: list[str] = []
    node = Node("brief", domain, logged.append, lambda: False)
    Fast(node, domain, network(os.environ, LARGEST)).leave()  # create what Fast DDS keeps for the whole process
    before = resources()
    replies: list[tuple[str, bytes, bytes]] = []
    fast = Fast(node, domain, network(os.environ, LARGEST))
    requests, responses = side(f"rq{topic}Request"), side(f"rr{topic}Reply")
    serving = fast.pair(requests, responses, ignore_peer)
    callers = {name: fast.pair(responses, requests, ignore_peer) for name in ("newer", "older")}
    serving.listen(reply, "serving")
    for name, pair in callers.items():
        pair.listen(lambda reply, name=name: replies.append((name, reply.call, reply.cdr)), name)
    until(lambda: len(serving.peers(True)) == 2 and all(pair.peers(True) for pair in callers.values()), 20)
    expected = {
        (name, pair.send(b"\0\1\0\0" + name.encode()), (b"\0\1\0\0" + name.encode()) * 2)
        for name, pair in callers.items()
    }
    until(lambda: expected <= set(replies), 20)
    assert len({call for _, call, _ in expected}) == 2
    assert not {name for name in resources() - before if "/dev/shm" in name}
    fast.leave()
    until(lambda: not resources() - before, 20)
    callers["newer"].send(b"late")
    assert logged == []


def ignore_peer(words: dict[str, str], is_writer: bool) -> None:
    """Ignore reports of peers."""
