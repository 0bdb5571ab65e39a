"""The short way from a sample to what ROS sends and back gives the bytes of the long one, in C as in Python."""

from __future__ import annotations

import random
import struct
import sys
import time
from pathlib import Path

import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from rosbags.typesys.store import Typestore

from shmgen.bridge.codec import cdr, transcode
from shmgen.bridge.codec.cdr import codec
from shmgen.bridge.codec.transcode import Transcoder
from shmgen.bridge.codec.wire_format import CDR, ROS1
from shmgen.bridge.plan import closure
from shmgen.config import Config
from shmgen.core.model import Role, Schema, TypeOptions
from shmgen.live.session import Session
from shmgen.runtime import CountExceeded, Time

from ..conftest import REPOSITORY
from ..support import build, counts, schemas

OPTIONS = [
    TypeOptions(),
    TypeOptions(time="LTIME", encoding="latin-1"),
    TypeOptions(time="struct", bool="BOOL"),
]
WHY_NOT = "the extension is not compiled, or this Python does not load it (SHMGEN_PURE)"
needs_c = pytest.mark.skipif(not transcode.EXTENSION, reason=WHY_NOT)


@needs_c
def test_the_extension_is_not_older_than_its_source() -> None:
    made = Path(sys.modules["shmgen._transcode"].__file__).stat().st_mtime
    assert made >= (REPOSITORY / "src/shmgen/bridge/codec/transcode.c").stat().st_mtime, (
        "pip install -e . makes it anew"
    )


@given(schema=schemas.schemas(), options=st.sampled_from(OPTIONS), seed=st.integers(0, 2**32))
@settings(max_examples=40, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
def test_any_message_goes_as_the_long_way(schema, options, seed, tmp_path_factory):
    folder = tmp_path_factory.mktemp("any")
    layouts = build.layouts_of(schema, options)
    package = f"transcoded_{folder.name}"
    build.put(build.texts_of(layouts, "python", package), folder)
    slots = [slot for layout in layouts.values() for slot in layout.slots]
    # No wstring, and rosbags makes a byte of an empty message for ROS 1 too.
    has_no_ros1 = any(slot.role is Role.FILLER or getattr(slot.type, "wide", False) for slot in slots)
    definitions = Schema(tuple(one.message for one in layouts.values()))
    for layout in layouts.values():
        kind, _, _ = build.classes(folder, package, layout.name)
        messages = closure(definitions, layout.name)
        long, ros1 = codec(messages), as_ros1(messages)
        to_ros2, to_ros1 = Both(layout, layouts, CDR), Both(layout, layouts, ROS1)
        draw = random.Random(seed)
        for _ in range(3):
            sample = payload_of(kind, schemas.random_message(layout, layouts, draw))
            message = long.new()
            kind._decode(sample, 0, message)
            try:
                wanted = long.encode(message)
            except struct.error:  # LTIME goes further than ROS
                with pytest.raises(struct.error):
                    to_ros2.encode(sample)
                continue
            assert to_ros2.encode(sample) == wanted, layout.message
            back = long.decode(wanted)
            assert to_ros2.decode(wanted) in (None, payload_of(kind, back))
            for damaged in spoiled(wanted, draw):
                to_ros2.decode(damaged)
            if has_no_ros1:
                continue
            try:
                sent = to_ros1.encode(sample)
            except struct.error:  # before 1970
                continue
            assert sent == ros1(back), layout.message
            assert to_ros1.decode(sent) in (None, payload_of(kind, back))


class Both:
    """The Python and the C, which may leave to the Python what is out of the ordinary, and has no other word for it."""

    def __init__(self, layout, layouts, wire_format, stamp=()):
        self.made = Transcoder(layout, layouts, wire_format, stamp)

    def encode(self, payload, now=Time):
        wanted = self.made._encoded(payload, now)
        assert self.made._encode_ordinary(payload, now) in (None, wanted)
        return wanted

    def decode(self, data):
        wanted = self.made._decoded(data)
        assert self.made._decode_ordinary(data) in (None, wanted)
        return wanted


def payload_of(kind, message) -> bytes:
    into, late = bytearray(kind()), []
    kind._encode(message, into, 0, late)
    for offset, room, array in late:
        into[offset : offset + room] = bytes(array).ljust(room, b"\0")
    return bytes(into)


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
    yield b"\0\0" + data[2:]  # big-endian


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


@needs_c
@pytest.mark.parametrize("wire_format", [CDR, ROS1], ids=["ROS 2", "ROS 1"])
@pytest.mark.parametrize("name", SOME)
def test_what_is_ordinary_goes_in_c(session, name, wire_format):
    layouts, kind = session.layouts([name]), session.message(name)
    made = Both(session.layout(name), layouts, wire_format)
    payload = bytes(kind(**SOME[name]))
    sent = made.made._encode_ordinary(payload, Time)
    assert sent == made.made._encode_ordinary(bytearray(payload), Time) == made.encode(payload)
    assert made.made._encode_ordinary(payload + b"x", Time) is None
    assert made.made._decode_ordinary(sent) == made.decode(sent) == payload


@pytest.mark.parametrize("wire_format", [CDR, ROS1], ids=["ROS 2", "ROS 1"])
def test_an_unset_stamp_becomes_now(session, wire_format):
    name = "geometry_msgs/PoseStamped"
    layouts, kind = session.layouts([name]), session.message(name)
    made = Both(session.layout(name), layouts, wire_format, ("header", "stamp"))
    now = Time(1_700_000_000, 123_456_789)
    unset, set_ = kind(), kind()
    set_.header.stamp = recent = Time(int(time.time()) - 5, 5_000_000)
    at = len(wire_format.head)
    assert struct.unpack_from("<iI", made.encode(bytes(unset), lambda: now), at) == now
    assert struct.unpack_from("<iI", made.encode(bytes(set_), lambda: now), at) == recent
    assert struct.unpack_from("<iI", made.encode(bytes(unset)), at) == (0, 0)
    assert made.made.encode(bytes(unset), lambda: now) == made.encode(bytes(unset), lambda: now)
    with pytest.raises(ZeroDivisionError):
        made.made.encode(bytes(unset), lambda: 1 // 0)


@pytest.mark.parametrize(("path", "count"), counts.PLACES[:2])
def test_a_count_beyond_its_bound_is_no_message(path, count, tmp_path):
    for name, text in counts.DEFINITIONS.items():
        build.put({f"counts_msgs/{name}.{name.partition('/')[0]}": text}, tmp_path)
    session = Session(Config(tmp_path, path=(tmp_path,)))
    layouts = session.layouts(["counts_msgs/Tree"])
    import types

    message = counts.tree(
        types.SimpleNamespace(**{k.rpartition("/")[2]: v for k, v in session.classes(["counts_msgs/Tree"]).items()}), 1
    )
    encode = Transcoder(session.layout("counts_msgs/Tree"), layouts).encode
    assert encode(bytes(message))
    counts.spoil(message, path, count)
    with pytest.raises(CountExceeded):
        encode(bytes(message))
