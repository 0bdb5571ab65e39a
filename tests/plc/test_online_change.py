"""An online change that brings other messages while the blocks run: nothing is read or written by the layout of before.

Each instance goes on in the changed program as CODESYS's help has it (tests/softplc/online_change.py). Where all are
new, they find the old regions, say so, and open new ones once those are gone.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from types import ModuleType
from typing import Any

import pytest

from shmgen.config import Config
from shmgen.generator import pipeline
from shmgen.runtime.region.names import region_name
from tests.softplc import Block, CompileError, Plc, compile_st, online_change

from ..support.build import module, put
from ..support.plc_demo import CLAIM, CONFIRM, RETRY, Memory, ready

MESSAGES = {
    "a_msgs/msg/Demo.msg": "uint32 a\nfloat64[4] v\nuint32 b\n",
    "a_msgs/srv/Ask.srv": "uint64[2] question\n---\nuint64[2] answer\n",
    "a_msgs/action/Go.action": "uint32[2] target\n---\nuint32[2] reached\n---\nuint32[2] position\n",
}
CHANGES = {
    "smaller": {"float64[4] v": "float64[2] v", "uint64[2] question": "uint64 question", "uint32[2] target": ""},
    "larger": {
        "float64[4] v": "float64[12] v",
        "uint64[2] answer": "uint64[14] answer",
        "uint32[2] position": "uint32[40] position",
    },
    "retyped": {
        "float64[4] v": "int64[4] v",
        "uint64[2] question": "float64[2] question",
        "uint32[2] reached": "float32[2] reached",
    },
}
"""What becomes of which lines. Each part of the service and of the action is changed by one or two of them."""
REFUSED = ("REGION_SIZE_MISMATCH", "DIGEST_MISMATCH")


@dataclass(frozen=True)
class Made:
    """A program, and the Python side of its messages."""

    plc: Plc
    python: ModuleType


def made(folder: Path, change: str) -> Made:
    messages = MESSAGES
    for old, new in CHANGES.get(change, {}).items():
        messages = {file: text.replace(old, new) for file, text in messages.items()}
    put(messages, folder)
    config = Config(folder, path=(folder,), package=f"shm_{change}", targets=("python", "st"))
    names = ["a_msgs/Demo", "a_msgs/Ask", "a_msgs/Go"]
    texts = pipeline.generate(config, names)
    put({path: text for path, text in texts.items() if path.startswith("python/")}, folder)
    plc = compile_st({path: text for path, text in texts.items() if path.endswith(".st")}, folder / "plc")
    return Made(plc, module(folder, f"shm_{change}", next(iter(pipeline.lay_out(config, names)))))


@pytest.fixture(scope="module")
def program(tmp_path_factory: pytest.TempPathFactory) -> Callable[[str], Made]:
    """Made once each: that of before, and the changed ones."""
    found: dict[str, Made] = {}

    def find(change: str) -> Made:
        if change not in found:
            found[change] = made(tmp_path_factory.mktemp(change), change)
        return found[change]

    return find


@pytest.fixture
def before(program: Callable[[str], Made]) -> Made:
    return at(0, program("before"))


@pytest.fixture(params=CHANGES)
def after(request: pytest.FixtureRequest, program: Callable[[str], Made]) -> Made:
    return at(0, program(request.param))


def at(ms: int, made: Made) -> Made:
    made.plc.set_clock(ms)
    return made


def block(made: Made, name: str, topic: str, **inputs: Any) -> Block:
    found = made.plc.block(f"FB_a_msgs_{name}")
    where = {"Demo": "sTopic", "Ask": "sService", "Go": "sAction"}[name.partition("_")[0]]
    for name, value in {"xEnable": True, where: topic, **inputs}.items():
        setattr(found, name, value)
    return found


def remove(topic: str, after: Made) -> None:
    """The regions that the changed program refuses, as an engineer does who was told so."""
    new = {after.plc.globals(name).SHM_DIGEST for name in after.plc.types if name.startswith("GVL_A_MSGS")}
    for file in Path("/dev/shm").glob(f"{region_name(topic)}*"):
        if int.from_bytes(file.read_bytes()[8:16], "little") not in new:
            for also in Path("/dev/shm").glob(f"*{file.name}*"):
                also.unlink()


def open_anew(*blocks: Block) -> None:
    """The old regions are gone; long enough passes for all to open new ones."""
    now = blocks[0].plc.now
    for ms in (RETRY, CLAIM, CONFIRM, CLAIM, CONFIRM):
        now += ms
        blocks[0].plc.set_clock(now)
        for one in blocks:
            one()


# --- topics -------------------------------------------------------------------------------------------


@pytest.mark.slow
def test_a_publisher_leaves_the_region_of_the_old_message(before: Made, after: Made, topic: str) -> None:
    old = ready(block(before, "Demo_Publisher", topic))
    assert old.xSent
    old.Msg.a, old.Msg.b = 7, 9
    with before.python.DemoSubscriber(topic) as subscriber:
        assert subscriber.read() is not None
        samples = Memory(topic).bytes()[192:]
        new = online_change(old, after.plc)
        assert (new.Msg.a, new.Msg.b) == (7, 9)
        for _ in range(3):
            new()
            assert (new.xSent, new.xError, new.eErrorID in REFUSED) == (False, True, True)
        assert Memory(topic).bytes()[192:] == samples
        assert subscriber.read() is None
    remove(topic, after)
    open_anew(new)
    assert (new.xSent, new.eErrorID) == (True, "NO_ERROR")
    with after.python.DemoSubscriber(topic) as subscriber:
        message = subscriber.read()
        assert (message.a, message.b, len(message.v)) == (7, 9, len(new.Msg.v))


@pytest.mark.family("[larger]")
def test_a_subscriber_takes_nothing_of_the_old_message(before: Made, after: Made, topic: str) -> None:
    with before.python.DemoPublisher(topic) as publisher:
        publisher.publish(before.python.Demo(a=1, b=2, v=[1.5] * 4))
        old = block(before, "Demo_Subscriber", topic)()
        assert (old.xNewData, old.Msg.a, old.Msg.v[3], old.Msg.b) == (True, 1, 1.5, 2)
        new = online_change(old, after.plc)
        for number in range(3):
            publisher.publish(before.python.Demo(a=number, b=2, v=[2.5] * 4))
            new()
            assert (new.xNewData, new.xValid, new.eErrorID in REFUSED) == (False, False, True)
        assert (new.Msg.a, list(new.Msg.v), new.Msg.b) == (1, [0] * len(new.Msg.v), 2)
    remove(topic, after)
    with after.python.DemoPublisher(topic) as publisher:
        publisher.publish(after.python.Demo(a=3, b=4, v=range(len(new.Msg.v))))
        open_anew(new)
        assert (new.xValid, new.eErrorID) == (True, "NO_ERROR")
        assert (new.Msg.a, list(new.Msg.v), new.Msg.b) == (3, list(range(len(new.Msg.v))), 4)


@pytest.mark.family("[smaller]")
def test_a_sample_read_before_counts_no_longer_once_the_region_is_that_of_the_new_message(
    before: Made, after: Made, topic: str
) -> None:
    """Python has changed first, and made a region of the new message while this block held the old one."""
    with before.python.DemoPublisher(topic) as publisher:
        publisher.publish(before.python.Demo(a=1))
        old = block(before, "Demo_Subscriber", topic)()
        assert old.xValid
    remove(topic, after)
    with after.python.DemoPublisher(topic) as publisher:
        new = online_change(old, after.plc)
        assert (new().xValid, new.xNewData, new.eErrorID) == (False, False, "NO_ERROR")
        publisher.publish(after.python.Demo(a=2))
        assert (new().xValid, new.Msg.a) == (True, 2)


@pytest.mark.parametrize("name", ["Demo_Publisher", "Demo_Subscriber"])
def test_a_method_called_before_the_block_touches_nothing(before: Made, after: Made, topic: str, name: str) -> None:
    """The runtime has called FB_Reinit by then."""
    old = ready(block(before, name, topic))
    with before.python.DemoPublisher(f"{topic}/other"):
        bytes_before = Memory(topic).bytes()[192:]
        new = online_change(old, after.plc)
        assert new.method("Write" if name.endswith("Publisher") else "Read") is False
        assert Memory(topic).bytes()[192:] == bytes_before


def test_without_fb_reinit_the_next_call_sees_it(
    before: Made, after: Made, topic: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Where only code was exchanged, no method is called."""
    old = ready(block(before, "Demo_Publisher", topic))
    samples = Memory(topic).bytes()[192:]
    monkeypatch.setattr(type(after.plc), "runs", lambda plc, name, method="": not method)
    new = online_change(old, after.plc)
    monkeypatch.undo()
    assert (new().xSent, new.eErrorID in REFUSED) == (False, True)
    assert Memory(topic).bytes()[192:] == samples


def test_the_same_message_goes_on(program: Callable[[str], Made], before: Made, topic: str) -> None:
    """Moved in memory, and nothing else: no sample is left out, nothing is opened anew."""
    publisher, subscriber = ready(block(before, "Demo_Publisher", topic)), block(before, "Demo_Subscriber", topic)()
    first = publisher.udiSequence
    publisher, subscriber = (online_change(one, before.plc) for one in (publisher, subscriber))
    publisher.Msg.a = 5
    assert (publisher().xSent, publisher.udiSequence) == (True, first + 1)
    assert (subscriber().xNewData, subscriber.Msg.a, subscriber.udiSequence) == (True, 5, first + 1)


# --- services and actions -----------------------------------------------------------------------------


PAIRS = [("Ask_Server", "Ask_Client"), ("Go_ActionServer", "Go_ActionClient")]


@pytest.fixture(params=PAIRS, ids=["service", "action"])
def names(request: pytest.FixtureRequest) -> tuple[str, str]:
    """Of a server and its client."""
    return request.param


@pytest.fixture
def pair(names: tuple[str, str], before: Made, topic: str) -> tuple[Block, Block]:
    """A server, and a client whose call it serves just now."""
    server, client = (ready(block(before, name, topic)) for name in names)
    client(xExecute=True)
    assert (server().xExecute, client().xBusy) == (True, True)
    return server, client


def slots(topic: str) -> dict[str, bytes]:
    """What is in the slots of all regions of a service or action."""
    prefix = region_name(topic)
    return {path.name: path.read_bytes()[192:] for path in Path("/dev/shm").glob(f"{prefix}-*")}


def test_a_call_fails_with_its_messages(
    names: tuple[str, str], pair: tuple[Block, Block], after: Made, topic: str
) -> None:
    """Once, and is not sent again while xExecute stays: the server may have done it."""
    server, client = pair
    samples = slots(topic)
    new = online_change(client, after.plc)
    for _ in range(3):
        new()
        assert (new.xError, new.xBusy, new.xDone, new.eErrorID) == (True, False, False, "DIGEST_MISMATCH")
    new(xExecute=False)
    assert (new.xError, new.eErrorID in REFUSED) == (False, True)
    assert slots(topic) == samples
    remove(topic, after)
    server = block(after, names[0], topic)
    open_anew(server, new)
    new(xExecute=True)
    assert (server().xExecute, server(xDone=True).xExecute) == (True, False)
    assert (new().xDone, new.eErrorID) == (True, "NO_ERROR")


def test_a_call_that_has_ended_is_not_made_again(pair: tuple[Block, Block], after: Made, topic: str) -> None:
    server, client = pair
    server(xDone=True)
    assert client().xDone
    new = online_change(client, after.plc)
    for _ in range(3):
        assert (new().xDone, new.xBusy) == (True, False)
    assert new(xExecute=False).xDone is False


def test_a_server_lets_go_of_the_call(
    names: tuple[str, str], pair: tuple[Block, Block], after: Made, topic: str
) -> None:
    samples = slots(topic)
    new = online_change(pair[0], after.plc)
    for _ in range(3):
        new(xDone=True)
        assert (new.xExecute, new.xError, new.eErrorID in REFUSED) == (False, True, True)
    assert slots(topic) == samples
    remove(topic, after)
    caller = block(after, names[1], topic)
    new(xDone=False)
    open_anew(new, caller)
    caller(xExecute=True)
    assert (new().xExecute, new(xDone=True).xExecute, caller().xDone) == (True, False, True)


# --- retained memory ----------------------------------------------------------------------------------

RETAINED = "PROGRAM PRG_Own VAR RETAIN fb : {}; END_VAR END_PROGRAM"
DECLARED = [
    *((RETAINED, name) for name in ("Demo_Publisher", "Demo_Subscriber", *PAIRS[0], *PAIRS[1])),
    ("PROGRAM PRG_Own VAR PERSISTENT fb : ARRAY[0..1] OF {}; END_VAR END_PROGRAM", "Demo_Publisher"),
    (
        "FUNCTION_BLOCK FB_Own VAR fb : {}; END_VAR END_FUNCTION_BLOCK "
        "PROGRAM PRG_Own VAR RETAIN own : FB_Own; END_VAR END_PROGRAM",
        "Demo_Publisher",
    ),
]


@pytest.mark.parametrize(("own", "name"), DECLARED)
def test_no_block_lies_in_retained_memory(tmp_path: Path, own: str, name: str) -> None:
    """Its pointers would come back after a power failure, and what they point to would not."""
    put(MESSAGES, tmp_path)
    config = Config(tmp_path, path=(tmp_path,), targets=("st",))
    texts = pipeline.generate(config, ["a_msgs/Demo", "a_msgs/Ask", "a_msgs/Go"])
    sources = {path: text for path, text in texts.items() if path.endswith(".st")}
    with pytest.raises(CompileError, match=f"PRG_OWN.*FB_A_MSGS_{name.upper()} is 'no_instance_in_retain'"):
        compile_st(sources | {"PRG_Own.st": own.format(f"FB_a_msgs_{name}")})
