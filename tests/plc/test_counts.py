"""No block passes on a count above its bound, which a peer in C, another PLC or damage can write."""

from __future__ import annotations

import importlib
import sys
from dataclasses import dataclass
from pathlib import Path
from types import ModuleType
from typing import Any

import pytest

from shmgen.config import Config
from shmgen.generator import pipeline
from tests.softplc import Block, Plc, compile_st

from ..support.build import put
from ..support.counts import DEFINITIONS, MOST, PACKAGE, PLACES, spoil, tree
from ..support.plc_calls import nth
from ..support.plc_demo import ready

pytestmark = pytest.mark.slow


@dataclass(frozen=True)
class Counts:
    plc: Plc
    msg: ModuleType
    srv: ModuleType
    action: ModuleType

    def block(self, name: str, **inputs: Any) -> Block:
        block = self.plc.block(f"FB_counts_msgs_{name}")
        for key, value in {"xEnable": True, **inputs}.items():
            setattr(block, key, value)
        return ready(block)


@pytest.fixture(scope="module")
def counts(tmp_path_factory: pytest.TempPathFactory) -> Counts:
    folder = tmp_path_factory.mktemp("counts")
    for name, text in DEFINITIONS.items():
        put({f"counts_msgs/{name}.{name.partition('/')[0]}": text}, folder)
    config = Config(folder, path=(folder,), package=PACKAGE, targets=("python", "st"))
    texts = pipeline.generate(config, ["counts_msgs"])
    put({path: text for path, text in texts.items() if path.startswith("python/")}, folder)
    plc = compile_st({path: text for path, text in texts.items() if path.endswith(".st")}, folder / "plc")
    sys.path.insert(0, str(folder / "python"))
    modules = [importlib.import_module(f"{PACKAGE}.counts_msgs.{kind}") for kind in ("msg", "srv", "action")]
    sys.path.pop(0)
    return Counts(plc, *modules)


@pytest.mark.parametrize(("path", "count"), PLACES)
def test_subscriber_refuses_a_count_above_its_bound(counts: Counts, topic: str, path: str, count: int) -> None:
    with counts.msg.TreePublisher(topic) as publisher:
        block = counts.block("Tree_Subscriber", sTopic=topic)
        publisher.publish(tree(counts.msg, 1))
        assert (block().xNewData, block.Msg.a, block.udiSequence, block.udiRefused) == (True, 1, 1, 0)
        bad = tree(counts.msg, 2)
        spoil(bad, path, count)
        publisher.publish(bad)
        for _ in range(2):  # the error stays as long as the sample is the newest
            assert (block().xNewData, block.xValid, block.eErrorID) == (False, False, "COUNT_EXCEEDED")
            assert (block.xError, block.xBusy, block.udiRefused, block.udiSequence) == (True, False, 1, 1)
            assert (block.Msg.a, block.Msg.b, block.Msg.tail_count, list(block.Msg.tail)) == (1, 2, 3, [1, 1, 1])
        publisher.publish(bad)
        assert block().udiRefused == 2
        publisher.publish(tree(counts.msg, 3))
        assert (block().xNewData, block.xValid, block.eErrorID, block.Msg.a) == (True, True, "NO_ERROR", 3)
        assert (block.udiSequence, block.udiMissed, block.udiRefused) == (4, 0, 2)


@pytest.mark.parametrize("path", ["crown[1].leaves[0].weights", "trunk.leaves[2].weights"])
def test_counts_in_unused_elements_are_ignored(counts: Counts, topic: str, path: str) -> None:
    """Ignore elements behind the last valid element, which may contain anything."""
    with counts.msg.TreePublisher(topic) as publisher:
        message = tree(counts.msg, 1)
        spoil(message, path, MOST)
        message._crown_count = 1
        message.trunk._leaves_count = 0
        publisher.publish(message)
        block = counts.block("Tree_Subscriber", sTopic=topic)
        assert (block.xValid, block.eErrorID) == (True, "NO_ERROR")


@pytest.mark.parametrize(("path", "count"), PLACES)
def test_publisher_refuses_a_count_above_its_bound(counts: Counts, topic: str, path: str, count: int) -> None:
    block = counts.block("Tree_Publisher", sTopic=topic, udiDepth=1)
    assert (block.xSent, block.udiSequence, block.eErrorID) == (True, 1, "NO_ERROR")
    member = block.Msg
    *owners, name = path.split(".")
    for owner in owners:
        field, _, index = owner.rstrip("]").partition("[")
        inner = getattr(member, field)
        if index and field != "pair":  # the element is valid, so the block checks it
            setattr(member, f"{field}_count", int(index) + 1)
        member = inner[int(index)] if index else inner
    setattr(member, f"{name}_count", count)
    for _ in range(2):
        assert (block().xSent, block.xError, block.eErrorID, block.udiSequence) == (False, True, "COUNT_EXCEEDED", 1)
    assert (block(xSend=False).eErrorID, block.xError) == ("NO_ERROR", False)
    setattr(member, f"{name}_count", 0)
    assert (block(xSend=True).xSent, block.eErrorID, block.udiSequence) == (True, "NO_ERROR", 2)


def test_refused_samples_are_counted_one_by_one(counts: Counts, topic: str) -> None:
    with counts.msg.TreePublisher(topic, depth=4) as publisher:
        block = counts.block("Tree_Subscriber", sTopic=topic, xNewest=False, udiDepth=4)
        for number in range(1, 5):
            message = tree(counts.msg, number)
            if number % 2 == 0:
                message._tail_count = 9
            publisher.publish(message)
        seen = [(block().xNewData, block.Msg.a, block.udiRefused, block.udiSequence) for _ in range(4)]
        assert seen == [(True, 1, 0, 1), (False, 1, 1, 1), (True, 3, 1, 3), (False, 3, 2, 3)]
        assert block.udiMissed == 0
        block(xEnable=False)
        assert (block.eErrorID, block.xError) == ("NO_ERROR", False)


def test_server_fails_a_call_with_a_count_above_its_bound(counts: Counts, topic: str) -> None:
    server = counts.block("Sort_Server", sService=topic)
    with counts.srv.SortClient(topic) as client:
        for number in (1, 2):
            request = counts.srv.Sort_Request(id=number, items=[3, 1])
            if number == 1:
                request._items_count = 5
            sent = client._calls.send_request(request)
            server()
            if number == 1:
                assert (server.xExecute, server.eErrorID, server.xError) == (False, "COUNT_EXCEEDED", True)
                assert (server.udiRefused, server.Request.id, server.Request.items_count) == (1, 0, 0)
                assert server().xExecute is False
                reply = client._calls.poll()
                assert (reply.call, reply.status == counts.srv.Sort_Reply.FAILED) == (sent, True)
                assert client._calls.poll() is None
            else:
                assert (server.xExecute, server.eErrorID, server.Request.id) == (True, "NO_ERROR", 2)
                assert (server.Request.items_count, list(server.Request.items)[:2]) == (2, [3, 1])


def test_server_answers_a_refused_call_before_the_next(counts: Counts, topic: str) -> None:
    server, client = counts.block("Sort_Server", sService=topic), counts.block("Sort_Client", sService=topic)
    client.Request.items_count = 5
    client(xExecute=True)
    assert (server().xExecute, server.udiCall) == (False, nth(1))
    client(xExecute=False, xCancel=True)
    client.Request.items_count = 4
    client(xExecute=True, xCancel=False)
    assert client.udiCall == nth(2)
    assert (server().xExecute, client().xBusy) == (False, True)
    assert (server().xExecute, server.udiCall, server.eErrorID) == (True, nth(2), "NO_ERROR")


def test_response_with_a_count_above_its_bound_fails_the_call(counts: Counts, topic: str) -> None:
    server, client = counts.block("Sort_Server", sService=topic), counts.block("Sort_Client", sService=topic)
    for count, seen, error in ((4, True, "NO_ERROR"), (5, False, "COUNT_EXCEEDED"), (0, True, "NO_ERROR")):
        client(xExecute=False)
        client(xExecute=True)
        server()
        server.Response.sorted_count = count
        server(xDone=True)
        server(xDone=False)
        assert (client().xDone, client.xError, client.eErrorID) == (seen, not seen, error)
        assert client.Response.sorted_count == (count if seen else 4)


def open_action_blocks(counts: Counts, topic: str) -> tuple[Block, Block]:
    return counts.block("Walk_ActionServer", sAction=topic), counts.block("Walk_ActionClient", sAction=topic)


def test_goal_with_a_count_above_its_bound_is_rejected(counts: Counts, topic: str) -> None:
    server, client = open_action_blocks(counts, topic)
    client.Goal.steps_count = 4
    client(xExecute=True)
    assert (server().xExecute, server.eErrorID, server.udiRefused) == (False, "COUNT_EXCEEDED", 1)
    server()
    assert (client().xError, client.eErrorID, client.siStatus) == (True, "CALL_FAILED", -1)
    client(xExecute=False)
    client.Goal.steps_count = 3
    client(xExecute=True)
    assert (server().xExecute, server.eErrorID, server.Goal.steps_count) == (True, "NO_ERROR", 3)


def test_feedback_and_result_with_a_high_count_are_refused(counts: Counts, topic: str) -> None:
    server, client = open_action_blocks(counts, topic)
    client(xExecute=True)
    server()
    for place, count, new in ((1, 2, True), (2, 3, False), (3, MOST, False), (4, 1, True)):
        server.Feedback.place, server.Feedback.done_count = place, count
        server()
        assert (client().xNewFeedback, client.xBusy, client.eErrorID) == (new, True, "NO_ERROR")
        assert client.Feedback.place == (place if new else 1)
    assert client.udiRefused == 2
    server.Result.left_count = 3
    server(xDone=True)
    assert (client().xDone, client.xError, client.eErrorID) == (False, True, "COUNT_EXCEEDED")
    assert client.Result.left_count == 0


def test_block_without_sequences_has_no_count_check(tmp_path: Path) -> None:
    put({"counts_msgs/msg/Plain.msg": "uint32 a\nfloat64[3] b\n"}, tmp_path)
    config = Config(tmp_path, path=(tmp_path,), targets=("st",))
    text = pipeline.generate(config, ["counts_msgs/Plain"])["st/counts_msgs/FB_counts_msgs_Plain_Subscriber.st"]
    assert not [word for word in ("Fits", "_xRefused", "udiRefused", "COUNT_EXCEEDED") if word in text]
