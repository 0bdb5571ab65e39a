"""ROS's bytes by the walker in C, by that in Python, by rosbags and by genpy are the same, and back."""

from __future__ import annotations

import pickle
import random
import re
import struct
import subprocess
import time
from functools import partial
from types import SimpleNamespace

import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from rosbags.typesys.store import Typestore

from shmgen.bridge.codec import cdr
from shmgen.bridge.codec.cdr import codec
from shmgen.bridge.codec.direct import Transcoder
from shmgen.bridge.plan import closure
from shmgen.config import Config
from shmgen.core.model import Role, Schema, TypeOptions, ros_type
from shmgen.live.session import Session
from shmgen.runtime import CountExceeded, OutOfRange, StringTooLong, Time, engine
from shmgen.runtime.messages import wire

from ..conftest import REPOSITORY
from ..support import build, counts, ros1, schemas

OPTIONS = [
    TypeOptions(),
    TypeOptions(time="LTIME", encoding="latin-1"),
    TypeOptions(time="struct", bool="BOOL"),
]


def classes_of(schema, options, folder):
    """The layouts of a schema, and a class for each."""
    layouts = build.layouts_of(schema, options)
    package = f"transcoded_{folder.name}"
    build.put(build.texts_of(layouts, "python", package), folder)
    return layouts, {name: build.classes(folder, package, name)[0] for name in layouts}


@pytest.mark.slow
@given(schema=schemas.schemas(), options=st.sampled_from(OPTIONS), seed=st.integers(0, 2**32))
@settings(max_examples=schemas.examples(40), deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
def test_any_message_goes_as_the_long_way(schema, options, seed, tmp_path_factory):
    layouts, kinds = classes_of(schema, options, tmp_path_factory.mktemp("any"))
    slots = [slot for layout in layouts.values() for slot in layout.slots]
    # No wstring, and rosbags makes a byte of an empty message for ROS 1 too.
    has_no_ros1 = any(slot.role is Role.FILLER or getattr(slot.type, "wide", False) for slot in slots)
    definitions = Schema(tuple(one.message for one in layouts.values()))
    for layout in layouts.values():
        kind = kinds[layout.name]
        messages = closure(definitions, layout.name)
        long, ros1, both = codec(messages), as_ros1(messages), Both(kind)
        draw = random.Random(seed)
        for _ in range(schemas.messages(3)):
            sample = bytes(kind._from_object(schemas.random_message(layout, layouts, draw)))
            message = long.new()
            kind._decode(sample, message)
            wanted = both.to_wire(sample)
            if isinstance(wanted, OutOfRange):  # LTIME goes further than ROS
                assert "ROS cannot hold this time" in str(wanted)
                with pytest.raises(struct.error):
                    long.encode(message)
                continue
            assert long.encode(message) == wanted, layout.message
            back = long.decode(wanted)
            assert both.from_wire(wanted) == bytes(kind._from_object(back))
            assert both.from_wire(both.to_wire(sample, big=True)) == both.from_wire(wanted)
            for damaged in spoiled(wanted, draw):
                both.from_wire(damaged)
            both.to_wire(draw.randbytes(len(sample)))
            if has_no_ros1:
                continue
            sent = both.to_wire(sample, ros1=True)
            if isinstance(sent, OutOfRange):  # before 1970
                continue
            assert sent == ros1(back), layout.message
            assert both.from_wire(sent, ros1=True) == bytes(kind._from_object(back))
            for damaged in spoiled(sent, draw):
                both.from_wire(damaged, ros1=True)


@given(schema=schemas.schemas(), options=st.sampled_from(OPTIONS), seed=st.integers(0, 2**32))
@settings(max_examples=schemas.examples(20), deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
def test_genpy_reads_and_writes_any_message_alike(genpy, schema, options, seed, tmp_path_factory):
    layouts, kinds = classes_of(schema, options, tmp_path_factory.mktemp("genpy"))
    definitions = Schema(tuple(one.message for one in layouts.values()))
    draw = random.Random(seed)
    for name, layout in layouts.items():
        messages, both = closure(definitions, name), Both(kinds[name])
        if any("wstring" in ros_type(field.type) for message in messages for field in message.fields):
            continue  # ROS 1 has none
        drawn = [schemas.random_message(layout, layouts, draw) for _ in range(schemas.messages(3))]
        samples = [bytes(both.kind._from_object(message)) for message in drawn]
        sent = [both.to_wire(sample, ros1=True) for sample in samples]
        held = [index for index, data in enumerate(sent) if isinstance(data, bytes)]  # the others are before 1970
        for index, (message, written) in zip(held, genpy(messages, [sent[index] for index in held]), strict=True):
            assert written == sent[index], layout.message
            assert bytes(both.kind._from_object(message)) == samples[index], layout.message
            assert both.from_wire(written, ros1=True) == samples[index]


@pytest.fixture(scope="module")
def genpy():
    """Returns what genpy reads and writes for serialized messages of a type; it runs in a Python that has it."""
    command = [ros1.python(), "tests/support/genpy_peer.py"]
    with subprocess.Popen(command, cwd=REPOSITORY, stdin=subprocess.PIPE, stdout=subprocess.PIPE) as peer:

        def convert(messages, samples):
            own, *others = [(message.name.short, definition(message)) for message in reversed(messages)]
            text = f"\n{'=' * 80}\n".join([own[1], *(f"MSG: {name}\n{text}" for name, text in others)])
            pickle.dump((own[0], text, samples), peer.stdin)
            peer.stdin.flush()
            return pickle.load(peer.stdout)

        yield convert


def definition(message):
    """As ROS 1 takes it, without bounds."""
    return "".join(f"{re.sub('<=[0-9]+', '', ros_type(field.type))} {field.name}\n" for field in message.fields)


class Both:
    """The walkers in C and in Python, and that they agree, in errors too."""

    def __init__(self, kind):
        self.kind, self.table = kind, engine.codec(kind)

    def to_wire(self, payload, ros1=False, big=False, stamp=(-1, Time)):
        wanted = outcome(wire.to_wire, self.kind, payload, ros1, big, *stamp)
        self.compare(wanted, lambda: self.table.to_wire(payload, ros1, big, *stamp))
        return wanted

    def from_wire(self, data, ros1=False):
        wanted = outcome(wire.from_wire, self.kind, data, ros1)
        self.compare(wanted, lambda: self.table.from_wire(data, ros1))
        return wanted

    def compare(self, wanted, call):
        if self.table is None:  # SHMGEN_PURE
            return
        found = outcome(call)
        if isinstance(wanted, Exception):
            assert type(found) is type(wanted), (found, wanted)
            assert type(wanted) is ValueError or str(found) == str(wanted)
        else:
            assert found == wanted


def outcome(call, *arguments):
    try:
        return call(*arguments)
    except ValueError as error:
        return error


def as_ros1(messages):
    store = Typestore()
    store.register(cdr._definitions(messages, "uint32"))
    return lambda message: bytes(store.serialize_ros1(message, str(messages[-1].name)))


def spoiled(data: bytes, draw: random.Random):
    """Cut anywhere, a byte changed anywhere, something behind it; some are messages all the same."""
    for _ in range(8):
        at = draw.randrange(len(data))
        yield data[:at]
        yield data[:at] + bytes([draw.choice([0, 1, 2, 127, 128, 255])]) + data[at + 1 :]
    yield data + bytes(4)
    yield b"\0\0" + data[2:]
    yield b"\0\2" + data[2:]
    yield b""


SOME = {
    "std_msgs/Header": {"frame_id": "a tool"},
    "geometry_msgs/PoseStamped": {},
    "sensor_msgs/BatteryState": {"location": "x" * 80, "present": True, "cell_voltage": [1.5, 2.5]},
    "sensor_msgs/JointState": {"name": ["one", ""], "position": [1.0, 2.0, 3.0]},
    "diagnostic_msgs/DiagnosticArray": {},
    "std_msgs/Empty": {},
}


@pytest.fixture(scope="module")
def session(tmp_path_factory) -> Session:
    from shmgen.config.entries import Bound, Bounds
    from shmgen.core.diagnostics import Span

    bounds = Bounds({}, {package: Bound(4, Span("test")) for package in ("sensor_msgs", "diagnostic_msgs")})
    return Session(Config(tmp_path_factory.mktemp("some"), source="jazzy", bounds=bounds))


@pytest.mark.parametrize("ros1", [False, True])
@pytest.mark.parametrize("name", SOME)
def test_messages_of_ros_there_and_back(session, name, ros1):
    kind = session.message(name)
    payload = bytes(kind(**SOME[name]))
    sent = Both(kind).to_wire(payload, ros1)
    assert Both(kind).from_wire(sent, ros1) == payload
    assert type(Both(kind).from_wire(sent + bytes(4), ros1)) is ValueError


@pytest.mark.parametrize("ros1", [False, True])
def test_an_unset_stamp_becomes_now(session, ros1):
    kind = session.message("geometry_msgs/PoseStamped")
    encode = partial(Transcoder(kind, ("header", "stamp")).encode, is_ros1=ros1)
    now = Time(1_700_000_000, 123_456_789)
    unset, set_ = kind(), kind()
    set_.header.stamp = recent = Time(int(time.time()) - 5, 5_000_000)
    at = 0 if ros1 else 4
    assert struct.unpack_from("<iI", encode(bytes(unset), now=lambda: now), at) == now
    assert struct.unpack_from("<iI", encode(bytes(set_), now=lambda: now), at) == recent
    assert struct.unpack_from("<iI", encode(bytes(unset)), at) == (0, 0)
    with pytest.raises(ZeroDivisionError):
        encode(bytes(unset), now=lambda: 1 // 0)


FRAME = {"frame_id": "a"}


@pytest.mark.parametrize(
    ("name", "changed", "where", "byte", "error", "said"),
    [
        ("std_msgs/Header", {"frame_id": "a"}, slice(12, 13), b"\xff", OutOfRange, "frame_id: the bytes end within it"),
        ("std_msgs/Header", {"frame_id": "a"}, slice(16, 17), b"\xff", OutOfRange, "frame_id: the bytes are no text"),
        (
            "std_msgs/Header",
            {"frame_id": "a"},
            slice(17, 18),
            b"b",
            OutOfRange,
            "frame_id: the text does not end in NUL",
        ),
        (
            "std_msgs/Header",
            {"frame_id": "a"},
            slice(12, 17),
            b"\xff\0\0\0" + b"x" * 254,
            StringTooLong,
            "frame_id: 254",
        ),
        ("std_msgs/Bool", {}, slice(4, 5), b"\2", OutOfRange, "data: the byte is no bool"),
        ("sensor_msgs/JointState", {}, slice(20, 21), b"\5", CountExceeded, "name: the writer says 5 elements"),
    ],
)
def test_what_is_refused_has_its_path(session, name, changed, where, byte, error, said):
    kind = session.message(name)
    data = bytearray(Both(kind).to_wire(bytes(kind(**changed))))
    data[where] = byte
    found = Both(kind).from_wire(bytes(data))
    assert type(found) is error
    assert said in str(found)


@pytest.mark.parametrize(("path", "count"), counts.PLACES[:2])
def test_a_count_beyond_its_bound_is_no_message(path, count, tmp_path):
    for name, text in counts.DEFINITIONS.items():
        build.put({f"counts_msgs/{name}.{name.partition('/')[0]}": text}, tmp_path)
    session = Session(Config(tmp_path, path=(tmp_path,)))
    classes = session.classes(["counts_msgs/Tree"])
    message = counts.tree(SimpleNamespace(**{name.rpartition("/")[2]: kind for name, kind in classes.items()}), 1)
    encode = Transcoder(session.message("counts_msgs/Tree")).encode
    assert encode(bytes(message))
    counts.spoil(message, path, count)
    with pytest.raises(CountExceeded) as raised:
        encode(bytes(message))
    assert raised.value.path
