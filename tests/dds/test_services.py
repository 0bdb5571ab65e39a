"""Services as rmw_cyclonedds has them, against ends that are made of plain topics."""

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
from .conftest import until

SERVICE = "int64 number\nstring word\n---\nbool success\nstring message\n"
NAMES = ("Ask_Request", "Ask_Response")
HEAD = {"client_guid_": types.uint64, "sequence_number_": types.int64}
REQUEST = make_idl_struct("Q", "cell_msgs::srv::dds_::Ask_Request_", {**HEAD, "number_": types.int64, "word_": str})
REPLY = make_idl_struct("A", "cell_msgs::srv::dds_::Ask_Response_", {**HEAD, "success_": bool, "message_": str})
"""After serdata.cpp of rmw_cyclonedds: 16 bytes of header, then the message."""


@pytest.fixture(scope="session")
def domain(testrun_uid: str, worker_id: str) -> int:
    """One more for each worker: Cyclone sets a domain up once in a process."""
    number = int(worker_id.removeprefix("gw")) if worker_id.startswith("gw") else 0
    return 1 + (zlib.crc32(testrun_uid.encode()) + number + 25) % 100


@pytest.fixture(autouse=True, params=["cyclone", "fast"])
def way(request: pytest.FixtureRequest, monkeypatch: pytest.MonkeyPatch) -> None:
    """Of Cyclone by the user's word, or with it for want of shmgen-fastdds; or of Fast DDS."""
    if request.param == "cyclone":
        monkeypatch.setenv("RMW_IMPLEMENTATION", "rmw_cyclonedds_cpp")
    if request.param == "no package":
        monkeypatch.setitem(sys.modules, "shmgen_fastdds", None)
    if request.param == "another":
        monkeypatch.setitem(sys.modules, "shmgen_fastdds", SimpleNamespace(Fast=of_another_fast_dds))
    if request.param == "fast":
        without_fast_dds()
    monkeypatch.setenv("ROS_AUTOMATIC_DISCOVERY_RANGE", "LOCALHOST")
    monkeypatch.setenv("CYCLONEDDS_URI", this_machine())


def of_another_fast_dds(*_: Any) -> None:
    raise OSError("libfastrtps.so.2.9: cannot open shared object file: No such file or directory")


@pytest.fixture
def wire(tmp_path: Path, topic: str) -> ServiceWire:
    file = tmp_path / "cell_msgs" / "srv" / "Ask.srv"
    file.parent.mkdir(parents=True)
    file.write_text(SERVICE)
    messages = pipeline.read(Config(Path.cwd(), path=(tmp_path,)), ["cell_msgs/Ask"]).messages
    request, response = ([message for message in messages if message.name.name == name] for name in NAMES)
    return ServiceWire(topic, tuple(request), tuple(response))


class Theirs:
    """The other end of the service: a reader of one topic, a writer of the other.

    Where it is not `known` it has nothing in its user data, as one on rmw_fastrtps.
    """

    def __init__(
        self, domain: int, service: str, role: str, known: bool = True, words: str = "", reads: bool = True
    ) -> None:
        serves = role == "serviceid"
        self.participant = DomainParticipant(domain)
        request = Topic(self.participant, f"rq{service}Request", REQUEST)
        reply = Topic(self.participant, f"rr{service}Reply", REPLY)
        policies = [Policy.Reliability.Reliable(10**9), Policy.History.KeepLast(10)]
        qos = Qos(*policies, *([Policy.Userdata(f"{role}=1.a.ff;{words}".encode())] if known else []))
        self.read = lambda: DataReader(self.participant, request if serves else reply, qos)
        if reads:
            self.reader = self.read()
        self.writer = DataWriter(self.participant, reply if serves else request, qos)

    def matched(self) -> bool:
        return bool(self.writer.get_matched_subscriptions() and self.reader.get_matched_publications())


def of_service(logged: list[str]) -> list[str]:
    """Leave out the lines about the domain."""
    return [line for line in logged if line.startswith("/")]


def test_serve(graph: backend.Graph, domain: int, wire: ServiceWire) -> None:
    def answer(request: Any, response: Any) -> None:
        if request.number < 0:
            raise NoAnswer("the PLC is in stop")
        response.success, response.message = True, f"{request.word} {request.number}"

    graph.serve(wire, answer, [].append)
    client = Theirs(domain, wire.name, "clientid")
    until(client.matched)
    client.writer.write(REQUEST(2**63 + 1, 7, -1, "lost"))
    client.writer.write(REQUEST(2**63 + 1, 8, 2**40, "grün"))
    reply = client.reader.take_one(timeout=20 * 10**9)
    assert reply == REPLY(2**63 + 1, 8, True, f"grün {2**40}")


def test_a_reply_waits_until_its_reader_is_known(graph: backend.Graph, domain: int, wire: ServiceWire) -> None:
    """Discovery brings the ends of a client one after another, and on a busy machine not at once."""
    asked = threading.Event()
    graph.serve(wire, lambda request, response: asked.set(), [].append)
    client = Theirs(domain, wire.name, "clientid", reads=False)
    until(client.writer.get_matched_subscriptions, 20)
    client.writer.write(REQUEST(1, 9, 0, ""))
    assert asked.wait(20)
    time.sleep(0.3)
    client.reader = client.read()
    assert client.reader.take_one(timeout=20 * 10**9) == REPLY(1, 9, False, "")


def test_a_failure_is_told(graph: backend.Graph, domain: int, wire: ServiceWire, logged: list[str]) -> None:
    def answer(request: Any, response: Any) -> None:
        raise NoAnswer("the PLC is in stop")

    graph.serve(wire, answer, [].append)
    client = Theirs(domain, wire.name, "clientid")
    until(client.matched)
    client.writer.write(REQUEST(1, 1, 1, ""))
    until(lambda: logged[-1] == f"{wire.name}: no answer: the PLC is in stop", 20)


def test_call(graph: backend.Graph, domain: int, wire: ServiceWire) -> None:
    caller = graph.client(wire)
    server = Theirs(domain, wire.name, "serviceid")
    until(server.matched, 20)

    def serve() -> None:
        for _ in range(3):
            asked = server.reader.take_one(timeout=20 * 10**9)
            head = asked.client_guid_, asked.sequence_number_
            server.writer.write(REPLY(head[0] ^ 1, head[1], False, "for another client"))
            server.writer.write(REPLY(head[0], head[1] + 1, False, "for another call"))
            server.writer.write(REPLY(*head, True, asked.word_ * asked.number_))

    thread = threading.Thread(target=serve)
    thread.start()
    for number in (1, 2, 3):
        request = caller.new()
        request.number, request.word = number, "a"
        response = caller.call(request, 20.0)
        assert (response.success, response.message) == (True, "a" * number)
    thread.join()


@pytest.mark.parametrize("there", [False, True], ids=["no server", "no answer"])
def test_no_answer(graph: backend.Graph, domain: int, wire: ServiceWire, there: bool) -> None:
    caller = graph.client(wire)
    server = Theirs(domain, wire.name, "serviceid") if there else None
    begun = time.monotonic()
    with pytest.raises(NoAnswer, match="no answer within 1 s" if server else "no server within 1 s"):
        caller.call(caller.new(), 1.0)
    assert 0.9 < time.monotonic() - begun < 5


def test_we_call_ourselves(graph: backend.Graph, wire: ServiceWire) -> None:
    graph.serve(wire, lambda request, response: setattr(response, "message", request.word), [].append)
    caller = graph.client(wire)
    request = caller.new()
    request.word = "echo"
    assert caller.call(request, 20.0).message == "echo"


def test_what_is_not_carried_any_more_leaves_the_graph(graph: backend.Graph, domain: int, wire: ServiceWire) -> None:
    """As after a reload; and it may come back."""
    client = Theirs(domain, wire.name, "clientid")
    for answer in ("before", "again"):
        graph.undo = []
        graph.serve(wire, lambda request, response, word=answer: setattr(response, "message", word), [].append)
        until(client.matched, 20)
        client.writer.write(REQUEST(1, 1, 1, ""))
        assert client.reader.take_one(timeout=20 * 10**9).message_ == answer
        for undo in graph.undo:
            undo()
        until(lambda: not client.writer.get_matched_subscriptions(), 20)
        until(lambda: not client.reader.get_matched_publications(), 20)


ANOTHER = f"typehash=RIHS01_{'1' * 64};"


def test_a_client_of_another_definition_does_not_reach_the_plc(
    graph: backend.Graph, domain: int, wire: ServiceWire, logged: list[str]
) -> None:
    refused: list[str] = []
    graph.serve(wire, lambda request, response: logged.append("answered"), refused.append)
    client = Theirs(domain, wire.name, "clientid", words=ANOTHER)
    until(client.matched)
    client.writer.write(REQUEST(1, 1, 1, ""))
    until(lambda: len(refused) >= 2)
    (line,) = of_service(logged)
    assert line.startswith(f"{wire.name}: a peer has another cell_msgs/Ask_Request: its type hash is RIHS01_1111")


def test_a_server_of_another_definition_is_not_asked(graph: backend.Graph, domain: int, wire: ServiceWire) -> None:
    caller = graph.client(wire)
    server = Theirs(domain, wire.name, "serviceid", words=ANOTHER)
    until(server.matched)
    with pytest.raises(NoAnswer, match="a peer has another cell_msgs/Ask_Request"):
        caller.call(caller.new(), 1.0)
    assert not server.reader.take(1)


without_fast = pytest.mark.parametrize("way", ["cyclone", "no package", "another"], indirect=True)


@without_fast
def test_a_client_of_another_middleware_does_not_reach_the_plc(
    graph: backend.Graph, domain: int, wire: ServiceWire, logged: list[str]
) -> None:
    refused: list[str] = []
    graph.serve(wire, lambda request, response: logged.append("answered"), refused.append)
    client = Theirs(domain, wire.name, "clientid", known=False)
    until(client.matched)
    client.writer.write(REQUEST(1, 1, 1, ""))
    until(lambda: len(refused) >= 2)
    (line,) = [line for line in of_service(logged) if "rmw_cyclonedds" in line]
    before, _, hint = line.partition("no messages pass between it and the bridge; ")
    assert before == f"{wire.name}: a peer is not on rmw_cyclonedds: "
    if "RMW_IMPLEMENTATION" not in os.environ:
        assert re.match(r"install shmgen-fastdds (where .*|again \(libfastrtps.so.2.9: .*)\), or start it with", hint)
    assert hint.endswith("start it with RMW_IMPLEMENTATION=rmw_cyclonedds_cpp, or the bridge with --backend ros2")


@pytest.mark.parametrize("way", ["fast"], indirect=True)
def test_what_is_no_request_is_refused(graph: backend.Graph, domain: int, wire: ServiceWire, logged: list[str]) -> None:
    """The header of the one kind, from who does not say that it is of it."""
    refused: list[str] = []
    graph.serve(wire, lambda request, response: logged.append("answered"), refused.append)
    client = Theirs(domain, wire.name, "clientid", known=False)
    until(client.matched, 20)
    client.writer.write(REQUEST(1, 1, 1, ""))
    until(lambda: refused, 20)
    assert any("CDR message size mismatch" in line for line in of_service(logged))
    assert "answered" not in logged


@without_fast
def test_a_server_of_another_middleware_is_not_asked(graph: backend.Graph, domain: int, wire: ServiceWire) -> None:
    caller = graph.client(wire)
    server = Theirs(domain, wire.name, "serviceid", known=False)
    until(server.matched)
    with pytest.raises(NoAnswer, match="a peer is not on rmw_cyclonedds"):
        caller.call(caller.new(), 1.0)
    assert not server.reader.take(1)


@pytest.mark.parametrize("way", ["fast"], indirect=True)
def test_servers_of_both_kinds_are_not_asked(graph: backend.Graph, domain: int, wire: ServiceWire) -> None:
    caller = graph.client(wire)
    servers = [Theirs(domain, wire.name, "serviceid", known=known) for known in (True, False)]
    why = "each would misread the other's requests"

    def knows_both() -> bool:
        try:
            caller.call(caller.new(), 0.2)
        except NoAnswer as error:
            return why in str(error)
        return False

    until(knows_both, 20)
    for server in servers:
        server.reader.take(100)  # of the time when one of them was not known yet
    with pytest.raises(NoAnswer, match=why):
        caller.call(caller.new(), 5.0)
    assert [server.reader.take(1) for server in servers] == [[], []]


@pytest.mark.parametrize("way", ["fast"], indirect=True)
def test_two_of_fast_dds_and_what_they_leave(domain: int, topic: str) -> None:
    """Each hears whose call it is, named by its reader or, as older ones do, by its writer. Then nothing is left."""

    def there() -> set[str]:
        folders = ("/proc/self/task", "/proc/self/fd")
        maps = Path("/proc/self/maps").read_text().split()  # of /dev/shm itself, others make files meanwhile
        return {f"{folder}/{name}" for folder in folders for name in os.listdir(folder)} | {
            word for word in maps if word.startswith("/dev/shm/")
        }

    def side(name: str) -> Direction:
        return Direction(name, "cell_msgs::srv::dds_::Ask_", object, "typehash=;")

    def reply(came: ReceivedCall) -> None:
        older = came.cdr.endswith(b"older")
        serving.send(came.cdr * 2, came.sender + came.call[16:] if older else came.call)

    from shmgen_fastdds import Fast

    logged: list[str] = []
    node = Node("brief", domain, logged.append, lambda: False)
    Fast(node, domain, network(os.environ, LARGEST)).leave()  # what is there once for all
    before = there()
    heard: list[tuple[str, bytes, bytes]] = []
    way = Fast(node, domain, network(os.environ, LARGEST))
    asked, answered = side(f"rq{topic}Request"), side(f"rr{topic}Reply")
    serving = way.pair(asked, answered, met)
    callers = {name: way.pair(answered, asked, met) for name in ("newer", "older")}
    serving.listen(reply, "serving")
    for name, pair in callers.items():
        pair.listen(lambda came, name=name: heard.append((name, came.call, came.cdr)), name)
    until(lambda: len(serving.peers(True)) == 2 and all(pair.peers(True) for pair in callers.values()), 20)
    wanted = {
        (name, pair.send(b"\0\1\0\0" + name.encode()), (b"\0\1\0\0" + name.encode()) * 2)
        for name, pair in callers.items()
    }
    until(lambda: wanted <= set(heard), 20)
    assert len({call for _, call, _ in wanted}) == 2
    assert not {name for name in there() - before if "/dev/shm" in name}
    way.leave()
    until(lambda: not there() - before, 20)
    callers["newer"].send(b"late")
    assert logged == []


def met(words: list[str], heard: bool) -> None:
    """Nobody wants to know."""
