"""After an online change of messages, running blocks read and write nothing with the old layout.

Each instance continues in the changed program as CODESYS's help describes (tests/softplc/online_change.py). The changed
blocks refuse the old regions, report an error, and open new regions once the old regions are removed.
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
"""The replaced lines of each change. One or two changes replace each part of the service and of the action."""
REFUSED = ("REGION_SIZE_MISMATCH", "DIGEST_MISMATCH")


@dataclass(frozen=True)
class Version:
    """A compiled program and the Python package of its messages."""

    plc: Plc
    python: ModuleType


def build_version(folder: Path, change: str) -> Version:
    messages = MESSAGES
    for old, new in CHANGES.get(change, {}).items():
        messages = {file: text.replace(old, new) for file, text in messages.items()}
    put(messages, folder)
    config = Config(folder, path=(folder,), package=f"shm_{change}", targets=("python", "st"))
    names = ["a_msgs/Demo", "a_msgs/Ask", "a_msgs/Go"]
    texts = pipeline.generate(config, names)
    put({path: text for path, text in texts.items() if path.startswith("python/")}, folder)
    plc = compile_st({path: text for path, text in texts.items() if path.endswith(".st")}, folder / "plc")
    return Version(plc, module(folder, f"shm_{change}", next(iter(pipeline.lay_out(config, names)))))


@pytest.fixture(scope="module")
def program(tmp_path_factory: pytest.TempPathFactory) -> Callable[[str], Version]:
    """A function that returns the program before or after a change, and builds each program once."""
    versions: dict[str, Version] = {}

    def find(change: str) -> Version:
        if change not in versions:
            versions[change] = build_version(tmp_path_factory.mktemp(change), change)
        return versions[change]

    return find


@pytest.fixture
def before(program: Callable[[str], Version]) -> Version:
    return set_clock(0, program("before"))


@pytest.fixture(params=CHANGES)
def after(request: pytest.FixtureRequest, program: Callable[[str], Version]) -> Version:
    return set_clock(0, program(request.param))


def set_clock(ms: int, version: Version) -> Version:
    version.plc.set_clock(ms)
    return version


def block(version: Version, name: str, topic: str, **inputs: Any) -> Block:
    instance = version.plc.block(f"FB_a_msgs_{name}")
    name_input = {"Demo": "sTopic", "Ask": "sService", "Go": "sAction"}[name.partition("_")[0]]
    for name, value in {"xEnable": True, name_input: topic, **inputs}.items():
        setattr(instance, name, value)
    return instance


def remove_refused_regions(topic: str, after: Version) -> None:
    """Remove the regions that the changed program refuses, as an engineer does after such an error."""
    new = {after.plc.globals(name).SHM_DIGEST for name in after.plc.types if name.startswith("GVL_A_MSGS")}
    for file in Path("/dev/shm").glob(f"{region_name(topic)}*"):
        if int.from_bytes(file.read_bytes()[8:16], "little") not in new:
            for also in Path("/dev/shm").glob(f"*{file.name}*"):
                also.unlink()


def let_blocks_open(*blocks: Block) -> None:
    """Advance the clock until all blocks have opened new regions. The old regions must be removed before."""
    now = blocks[0].plc.now
    for ms in (RETRY, CLAIM, CONFIRM, CLAIM, CONFIRM):
        now += ms
        blocks[0].plc.set_clock(now)
        for one in blocks:
            one()


# --- topics -------------------------------------------------------------------------------------------


@pytest.mark.slow
def test_publisher_writes_nothing_into_the_old_region(before: Version, after: Version, topic: str) -> None:
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
    remove_refused_regions(topic, after)
    let_blocks_open(new)
    assert (new.xSent, new.eErrorID) == (True, "NO_ERROR")
    with after.python.DemoSubscriber(topic) as subscriber:
        message = subscriber.read()
        assert (message.a, message.b, len(message.v)) == (7, 9, len(new.Msg.v))


@pytest.mark.family("[larger]")
def test_subscriber_reads_no_sample_of_the_old_message(before: Version, after: Version, topic: str) -> None:
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
    remove_refused_regions(topic, after)
    with after.python.DemoPublisher(topic) as publisher:
        publisher.publish(after.python.Demo(a=3, b=4, v=range(len(new.Msg.v))))
        let_blocks_open(new)
        assert (new.xValid, new.eErrorID) == (True, "NO_ERROR")
        assert (new.Msg.a, list(new.Msg.v), new.Msg.b) == (3, list(range(len(new.Msg.v))), 4)


@pytest.mark.family("[smaller]")
def test_old_sample_is_invalid_in_the_new_region(before: Version, after: Version, topic: str) -> None:
    """Drop the old sample if Python changed first and has already created the region of the new message."""
    with before.python.DemoPublisher(topic) as publisher:
        publisher.publish(before.python.Demo(a=1))
        old = block(before, "Demo_Subscriber", topic)()
        assert old.xValid
    remove_refused_regions(topic, after)
    with after.python.DemoPublisher(topic) as publisher:
        new = online_change(old, after.plc)
        assert (new().xValid, new.xNewData, new.eErrorID) == (False, False, "NO_ERROR")
        publisher.publish(after.python.Demo(a=2))
        assert (new().xValid, new.Msg.a) == (True, 2)


@pytest.mark.parametrize("name", ["Demo_Publisher", "Demo_Subscriber"])
def test_method_writes_nothing_before_the_block_is_called(
    before: Version, after: Version, topic: str, name: str
) -> None:
    """Return FALSE from Read and Write after an online change, until the block is called."""
    old = ready(block(before, name, topic))
    with before.python.DemoPublisher(f"{topic}/other"):
        bytes_before = Memory(topic).bytes()[192:]
        new = online_change(old, after.plc)
        assert new.method("Write" if name.endswith("Publisher") else "Read") is False
        assert Memory(topic).bytes()[192:] == bytes_before


def test_block_detects_a_change_without_fb_reinit(
    before: Version, after: Version, topic: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Report the change in the next call. CODESYS calls no method if only code was exchanged."""
    old = ready(block(before, "Demo_Publisher", topic))
    samples = Memory(topic).bytes()[192:]
    monkeypatch.setattr(type(after.plc), "runs", lambda plc, name, method="": not method)
    new = online_change(old, after.plc)
    monkeypatch.undo()
    assert (new().xSent, new.eErrorID in REFUSED) == (False, True)
    assert Memory(topic).bytes()[192:] == samples


def test_unchanged_message_needs_no_reopening(program: Callable[[str], Version], before: Version, topic: str) -> None:
    """Keep the regions open and skip no sample if an online change only moves the instances in memory."""
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
    """The names of a server block and its client block."""
    return request.param


@pytest.fixture
def pair(names: tuple[str, str], before: Version, topic: str) -> tuple[Block, Block]:
    """A server block and a client block whose call is in progress."""
    server, client = (ready(block(before, name, topic)) for name in names)
    client(xExecute=True)
    assert (server().xExecute, client().xBusy) == (True, True)
    return server, client


def read_slots(topic: str) -> dict[str, bytes]:
    """Return the bytes of the slots of all regions of a service or action."""
    prefix = region_name(topic)
    return {path.name: path.read_bytes()[192:] for path in Path("/dev/shm").glob(f"{prefix}-*")}


def test_call_in_progress_fails_after_a_change(
    names: tuple[str, str], pair: tuple[Block, Block], after: Version, topic: str
) -> None:
    """Send the call no second time while xExecute stays TRUE, because the server may have executed the call."""
    server, client = pair
    samples = read_slots(topic)
    new = online_change(client, after.plc)
    for _ in range(3):
        new()
        assert (new.xError, new.xBusy, new.xDone, new.eErrorID) == (True, False, False, "DIGEST_MISMATCH")
    new(xExecute=False)
    assert (new.xError, new.eErrorID in REFUSED) == (False, True)
    assert read_slots(topic) == samples
    remove_refused_regions(topic, after)
    server = block(after, names[0], topic)
    let_blocks_open(server, new)
    new(xExecute=True)
    assert (server().xExecute, server(xDone=True).xExecute) == (True, False)
    assert (new().xDone, new.eErrorID) == (True, "NO_ERROR")


def test_finished_call_is_not_sent_again(pair: tuple[Block, Block], after: Version, topic: str) -> None:
    server, client = pair
    server(xDone=True)
    assert client().xDone
    new = online_change(client, after.plc)
    for _ in range(3):
        assert (new().xDone, new.xBusy) == (True, False)
    assert new(xExecute=False).xDone is False


def test_server_drops_its_call_after_a_change(
    names: tuple[str, str], pair: tuple[Block, Block], after: Version, topic: str
) -> None:
    samples = read_slots(topic)
    new = online_change(pair[0], after.plc)
    for _ in range(3):
        new(xDone=True)
        assert (new.xExecute, new.xError, new.eErrorID in REFUSED) == (False, True, True)
    assert read_slots(topic) == samples
    remove_refused_regions(topic, after)
    caller = block(after, names[1], topic)
    new(xDone=False)
    let_blocks_open(new, caller)
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
@pytest.mark.family("own7")
def test_blocks_are_refused_in_retained_memory(tmp_path: Path, own: str, name: str) -> None:
    """Refuse the declaration: after a power failure, the pointers would be restored, but not the mapped memory."""
    put(MESSAGES, tmp_path)
    config = Config(tmp_path, path=(tmp_path,), targets=("st",))
    texts = pipeline.generate(config, ["a_msgs/Demo", "a_msgs/Ask", "a_msgs/Go"])
    sources = {path: text for path, text in texts.items() if path.endswith(".st")}
    with pytest.raises(CompileError, match=f"PRG_OWN.*FB_A_MSGS_{name.upper()} is 'no_instance_in_retain'"):
        compile_st(sources | {"PRG_Own.st": own.format(f"FB_a_msgs_{name}")})
