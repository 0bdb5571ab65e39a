"""Test that the codecs in C and in Python, rosbags and genpy convert samples to the same ROS bytes and back."""

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


def generate_classes(schema, options, folder):
    """Return the layouts of a schema, and the generated class of each."""
    layouts = build.layouts_of(schema, options)
    package = f"transcoded_{folder.name}"
    build.put(build.texts_of(layouts, "python", package), folder)
    return layouts, {name: build.classes(folder, package, name)[0] for name in layouts}


@pytest.mark.slow
@given(schema=schemas.schemas(), options=st.sampled_from(OPTIONS), seed=st.integers(0, 2**32))
@settings(max_examples=schemas.examples(40), deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
def test_codecs_equal_decoding_and_encoding_a_message(schema, options, seed, tmp_path_factory):
    layouts, kinds = generate_classes(schema, options, tmp_path_factory.mktemp("any"))
    slots = [slot for layout in layouts.values() for slot in layout.slots]
    # ROS 1 has no wstring, and rosbags encodes an empty message as one byte for ROS 1 too.
    has_no_ros1 = any(slot.role is Role.FILLER or getattr(slot.type, "wide", False) for slot in slots)
    definitions = Schema(tuple(layout_.message for layout_ in layouts.values()))
    for layout in layouts.values():
        kind, name = kinds[layout.name], str(layout.name)
        messages = closure(definitions, layout.name)
        reference, store, codecs = codec(messages), rosbags_store(messages), BothCodecs(kind)
        source = random.Random(seed)
        for _ in range(schemas.messages(3)):
            sample = bytes(kind._from_object(schemas.random_message(layout, layouts, source)))
            message = reference.new()
            kind._decode(sample, message)
            expected = codecs.to_wire(sample)
            if isinstance(expected, OutOfRange):  # LTIME has a wider range than ROS
                assert "ROS cannot represent this time" in str(expected)
                with pytest.raises(struct.error):
                    reference.encode(message)
                continue
            assert reference.encode(message) == expected, layout.message
            back = reference.decode(expected)
            assert codecs.from_wire(expected) == bytes(kind._from_object(back))
            swapped = bytes(store.serialize_cdr(store.deserialize_cdr(expected, name), name, little_endian=False))
            assert codecs.from_wire(swapped) == codecs.from_wire(expected)
            for damaged in damaged_copies(expected, source):
                codecs.from_wire(damaged)
            codecs.to_wire(source.randbytes(len(sample)))
            if has_no_ros1:
                continue
            sent = codecs.to_wire(sample, ros1=True)
            if isinstance(sent, OutOfRange):  # before 1970
                continue
            assert sent == bytes(store.serialize_ros1(back, name)), layout.message
            assert codecs.from_wire(sent, ros1=True) == bytes(kind._from_object(back))
            for damaged in damaged_copies(sent, source):
                codecs.from_wire(damaged, ros1=True)


@given(schema=schemas.schemas(), options=st.sampled_from(OPTIONS), seed=st.integers(0, 2**32))
@settings(max_examples=schemas.examples(20), deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
def test_genpy_reads_and_writes_the_same_bytes(genpy, schema, options, seed, tmp_path_factory):
    layouts, kinds = generate_classes(schema, options, tmp_path_factory.mktemp("genpy"))
    definitions = Schema(tuple(layout_.message for layout_ in layouts.values()))
    source = random.Random(seed)
    for name, layout in layouts.items():
        messages, codecs = closure(definitions, name), BothCodecs(kinds[name])
        if any("wstring" in ros_type(field.type) for message in messages for field in message.fields):
            continue  # ROS 1 has no wstring
        values = [schemas.random_message(layout, layouts, source) for _ in range(schemas.messages(3))]
        samples = [bytes(codecs.kind._from_object(message)) for message in values]
        sent = [codecs.to_wire(sample, ros1=True) for sample in samples]
        valid = [index for index, data in enumerate(sent) if isinstance(data, bytes)]  # others have times before 1970
        for index, (message, written) in zip(valid, genpy(messages, [sent[index] for index in valid]), strict=True):
            assert written == sent[index], layout.message
            assert bytes(codecs.kind._from_object(message)) == samples[index], layout.message
            assert codecs.from_wire(written, ros1=True) == samples[index]


@pytest.fixture(scope="module")
def genpy():
    """A function that decodes and encodes serialized messages of a type with genpy, in a Python that has genpy."""
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
    """Return the definition in the syntax of ROS 1, without bounds."""
    return "".join(f"{re.sub('<=[0-9]+', '', ros_type(field.type))} {field.name}\n" for field in message.fields)


class BothCodecs:
    """The codecs in C and in Python. Each call checks that both return equal results or errors."""

    def __init__(self, kind):
        self.kind, self.table = kind, engine.codec(kind)

    def to_wire(self, payload, ros1=False, stamp=(-1, Time)):
        expected = result_or_error(wire.to_wire, self.kind, payload, ros1, *stamp)
        self.compare(expected, lambda: self.table.to_wire(payload, ros1, *stamp))
        return expected

    def from_wire(self, data, ros1=False):
        expected = result_or_error(wire.from_wire, self.kind, data, ros1)
        self.compare(expected, lambda: self.table.from_wire(data, ros1))
        return expected

    def compare(self, expected, call):
        if self.table is None:  # SHMGEN_PURE
            return
        result = result_or_error(call)
        if isinstance(expected, Exception):
            assert type(result) is type(expected), (result, expected)
            assert type(expected) is ValueError or str(result) == str(expected)
        else:
            assert result == expected


def result_or_error(call, *arguments):
    try:
        return call(*arguments)
    except ValueError as error:
        return error


def rosbags_store(messages):
    store = Typestore()
    store.register(cdr._definitions(messages, "uint32"))
    return store


def damaged_copies(data: bytes, source: random.Random):
    """Yield truncated copies, copies with a changed byte, and longer copies. Some are still valid messages."""
    for _ in range(8):
        position = source.randrange(len(data))
        yield data[:position]
        yield data[:position] + bytes([source.choice([0, 1, 2, 127, 128, 255])]) + data[position + 1 :]
    yield data + bytes(4)
    yield b"\0\0" + data[2:]
    yield b"\0\2" + data[2:]
    yield b""


EXAMPLES = {
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
@pytest.mark.parametrize("name", EXAMPLES)
def test_ros_messages_round_trip(session, name, ros1):
    kind = session.message(name)
    payload = bytes(kind(**EXAMPLES[name]))
    sent = BothCodecs(kind).to_wire(payload, ros1)
    assert BothCodecs(kind).from_wire(sent, ros1) == payload
    assert type(BothCodecs(kind).from_wire(sent + bytes(4), ros1)) is ValueError


@pytest.mark.parametrize("ros1", [False, True])
def test_unset_stamp_becomes_the_current_time(session, ros1):
    kind = session.message("geometry_msgs/PoseStamped")
    encode = partial(Transcoder(kind, ("header", "stamp")).encode, is_ros1=ros1)
    now = Time(1_700_000_000, 123_456_789)
    unset, set_ = kind(), kind()
    set_.header.stamp = recent = Time(int(time.time()) - 5, 5_000_000)
    offset = 0 if ros1 else 4
    assert struct.unpack_from("<iI", encode(bytes(unset), now=lambda: now), offset) == now
    assert struct.unpack_from("<iI", encode(bytes(set_), now=lambda: now), offset) == recent
    assert struct.unpack_from("<iI", encode(bytes(unset)), offset) == (0, 0)
    with pytest.raises(ZeroDivisionError):
        encode(bytes(unset), now=lambda: 1 // 0)


@pytest.mark.parametrize(
    ("name", "values", "place", "byte", "error", "text"),
    [
        ("std_msgs/Header", {"frame_id": "a"}, slice(12, 13), b"\xff", OutOfRange, "frame_id: the bytes end within"),
        ("std_msgs/Header", {"frame_id": "a"}, slice(16, 17), b"\xff", OutOfRange, "frame_id: the bytes are not"),
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
        ("std_msgs/Bool", {}, slice(4, 5), b"\2", OutOfRange, "data: the byte is not a bool"),
        ("sensor_msgs/JointState", {}, slice(20, 21), b"\5", CountExceeded, "name: the region has 5 elements"),
    ],
)
def test_refused_message_has_its_field_path(session, name, values, place, byte, error, text):
    kind = session.message(name)
    data = bytearray(BothCodecs(kind).to_wire(bytes(kind(**values))))
    data[place] = byte
    result = BothCodecs(kind).from_wire(bytes(data))
    assert type(result) is error
    assert text in str(result)


@pytest.mark.parametrize(("path", "count"), counts.PLACES[:2])
def test_count_beyond_its_bound_is_rejected(path, count, tmp_path):
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
