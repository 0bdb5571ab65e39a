"""Compare the DDS description of a type and the encoded bytes with reference values."""

from __future__ import annotations

import ctypes
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest

from shmgen.bridge.codec import cdr
from shmgen.bridge.dds import types
from shmgen.config import Config
from shmgen.core.model import Message, TypeName
from shmgen.generator import pipeline

HASHES = {
    "builtin_interfaces/Time": "b106235e25a4c5ed35098aa0a61a3ee9c9b18d197f398b0e4206cea9acf9c197",
    "rosgraph_msgs/Clock": "692f7a66e93a3c83e71765d033b60349ba68023a8c689a79e48078bcb5c58564",
    "sensor_msgs/Range": "b42b62562e93cbfe9d42b82fe5994dfa3d63d7d5c90a317981703f7388adff3a",
    "std_msgs/Empty": "20b625256f32d5dbc0d04fee44f43c41e51c70d3502f84b4a08e7a9c26a96312",
    "std_msgs/String": "df668c740482bbd48fb39d76a70dfd4bd59db1288021743503259e948f6b1a18",
}
"""The hashes that ROS 2 Jazzy computes."""


def messages(request: str, folder: Path | None = None) -> tuple[Message, ...]:
    config = Config(Path.cwd(), path=(folder,) if folder else ())
    return pipeline.read(config, [request]).messages


@pytest.mark.parametrize(("request_", "hash_"), HASHES.items())
def test_type_hash(request_: str, hash_: str) -> None:
    assert cdr.codec(messages(request_)).type_hash == f"RIHS01_{hash_}"


def test_dds_names_of_types_and_topics() -> None:
    assert types.type_name(TypeName("std_srvs", "srv", "SetBool_Request")) == "std_srvs::srv::dds_::SetBool_Request_"
    assert types.topic_name("/robot/pose") == "rt/robot/pose"
    assert types.request_name("/robot/stop") == "rq/robot/stopRequest"
    assert types.reply_name("/robot/stop") == "rr/robot/stopReply"


def test_bytes_of_a_header() -> None:
    """Compare with bytes written by hand: encapsulation, seconds, nanoseconds, five bytes of text with their NUL."""
    codec = cdr.codec(messages("std_msgs/Header"))
    header = codec.new()
    header.stamp.sec, header.stamp.nanosec, header.frame_id = -1, 2, "mäp"
    wire = "00010000 ffffffff 02000000 05000000 6dc3a47000"
    assert codec.encode(header) == bytes.fromhex(wire)
    assert codec.decode(bytes.fromhex(wire)) == header
    big_endian = "00000000 ffffffff 00000002 00000005 6dc3a47000"
    assert codec.decode(bytes.fromhex(big_endian)) == header


def test_bytes_of_wide_strings(tmp_path: Path) -> None:
    """Compare with bytes written by hand: encapsulation, the number of units, the units of four or two bytes."""
    file = tmp_path / "cell_msgs" / "msg" / "Wide.msg"
    file.parent.mkdir(parents=True)
    file.write_text("wstring word\nuint8 last\nwstring[2] words\n")
    definitions = messages("cell_msgs/Wide", tmp_path)
    wires = {
        cdr.codec(definitions): (
            "00010000 02000000 61000000 e9000000 07 000000 01000000 3dd80000 00000000",
            "00000000 00000002 00000061 000000e9 07 000000 00000001 0000d83d 00000000",
        ),
        cdr.codec(definitions, wide_unit=2): (
            "00010000 02000000 6100 e900 07 000000 01000000 7a00 0000 00000000",
            "00000000 00000002 0061 00e9 07 000000 00000001 007a 0000 00000000",
        ),
    }
    for (codec, (little, big)), second in zip(wires.items(), (None, "z"), strict=True):
        for wire in (little, big):
            if second is None:  # half a character
                with pytest.raises(ValueError, match="utf-16"):
                    codec.decode(bytes.fromhex(wire))
                continue
            decoded = codec.decode(bytes.fromhex(wire) + bytes(8))  # Fast DDS appends padding
            assert (decoded.word, decoded.last, decoded.words) == ("aé", 7, ["z", ""])
        if second:
            assert codec.encode(decoded) == bytes.fromhex(little)
    codec = cdr.codec(definitions)
    message = codec.new()
    message.word, message.last, message.words = "aé", 7, ["\N{ROBOT FACE}", ""]
    wire = "00010000 02000000 61000000 e9000000 07 000000 02000000 3ed80000 16dd0000 00000000"
    assert codec.encode(message) == bytes.fromhex(wire)
    assert codec.decode(bytes.fromhex(wire)) == message


@pytest.mark.parametrize("bytes_", [b"", bytes(4), bytes.fromhex("00010000 ffffffff 02000000 05000000 6dc3")])
def test_truncated_bytes_raise_an_error(bytes_: bytes) -> None:
    with pytest.raises(ValueError, match=r"Header|encapsulation|string length"):
        cdr.codec(messages("std_msgs/Header")).decode(bytes_)


@pytest.mark.parametrize("positions", [[1.5, -2.0], (ctypes.c_double * 2)(1.5, -2.0), (1.5, -2.0)])
def test_elements_may_be_of_any_class(positions: Any) -> None:
    codec = cdr.codec(messages("trajectory_msgs/JointTrajectory"))
    trajectory = codec.new()
    nothing: list[float] = []
    trajectory.points = [
        SimpleNamespace(
            positions=positions,
            velocities=nothing,
            accelerations=nothing,
            effort=nothing,
            time_from_start=SimpleNamespace(sec=1, nanosec=5),
        )
    ]
    (point,) = codec.decode(codec.encode(trajectory)).points
    assert list(point.positions) == [1.5, -2.0]
    assert (point.time_from_start.sec, point.time_from_start.nanosec) == (1, 5)


@pytest.mark.parametrize("request_", ["sensor_msgs/Imu", "diagnostic_msgs/DiagnosticStatus"])
def test_encoding_skips_unneeded_conversion(request_: str, monkeypatch: pytest.MonkeyPatch) -> None:
    """Encode without `_to_rosbags`, which would visit each field and give the same bytes."""
    codec = cdr.codec(messages(request_))
    monkeypatch.delattr(cdr, "_to_rosbags")
    assert codec.encode(codec.new())


def test_elements_without_fields_are_one_byte_each(tmp_path: Path) -> None:
    """Encode each as one byte, although its class has no field."""
    file = tmp_path / "cell_msgs" / "msg" / "Ticks.msg"
    file.parent.mkdir(parents=True)
    file.write_text("std_msgs/Empty[] ticks\n")
    codec = cdr.codec(messages("cell_msgs/Ticks", tmp_path))
    assert codec.encode(SimpleNamespace(ticks=[SimpleNamespace()] * 2)) == bytes.fromhex("00010000 02000000 0000")
    file.write_text("wstring word\nstd_msgs/Empty tick\n")
    codec = cdr.codec(messages("cell_msgs/Ticks", tmp_path))
    assert codec.encode(codec.new()) == bytes.fromhex("00010000 00000000 00")
    codec = cdr.codec(messages("std_msgs/Empty"))
    assert codec.encode(codec.new()) == bytes.fromhex("00010000 00")


@pytest.mark.parametrize("field", ["wstring word", "wstring<=5[3] word", "wstring[] word"])
def test_wide_strings_are_rejected(tmp_path: Path, field: str) -> None:
    file = tmp_path / "cell_msgs" / "msg" / "Wide.msg"
    file.parent.mkdir(parents=True)
    file.write_text(field)
    with pytest.raises(ValueError, match=r"cell_msgs/Wide\.word is a wstring.* support"):
        types.structure(messages("cell_msgs/Wide", tmp_path))


def test_large_bound_and_reserved_names_are_encoded(tmp_path: Path) -> None:
    file = tmp_path / "cell_msgs" / "msg" / "Odd.msg"
    file.parent.mkdir(parents=True)
    file.write_text("uint8[<=100000] data\nfloat64 from\nbyte[2] class\nchar c\nstring<=4 s\nbool[<=3] flags\n")
    definitions = messages("cell_msgs/Odd", tmp_path)
    kind = types.structure(definitions)
    kind.__idl__.populate()
    kind.__idl__.fill_type_data()
    codec = cdr.codec(definitions)
    message = codec.new()
    message.from_ = 1.25
    decoded = codec.decode(codec.encode(message))
    assert (decoded.from_, list(decoded.class_), decoded.c) == (1.25, [0, 0], 0)


def test_new_message_has_zero_and_empty_fields(tmp_path: Path) -> None:
    file = tmp_path / "cell_msgs" / "msg" / "All.msg"
    file.parent.mkdir(parents=True)
    file.write_text(
        "bool flag\nfloat64 x\nint32 n\nstring s\nbuiltin_interfaces/Time t\n"
        "uint8[2] a\nbool[2] flags\nfloat64[] many\nstring[2] words\nstd_msgs/Bool[1] inner\nstd_msgs/Empty[] none\n"
    )
    new = cdr.codec(messages("cell_msgs/All", tmp_path)).new()
    assert (new.flag, new.x, new.n, new.s, new.t.sec, new.t.nanosec) == (False, 0.0, 0, "", 0, 0)
    assert (list(new.a), list(new.flags), list(new.many), new.words) == ([0, 0], [False, False], [], ["", ""])
    assert ([inner.data for inner in new.inner], new.none) == ([False], [])


def test_new_messages_share_no_data() -> None:
    codec = cdr.codec(messages("sensor_msgs/Imu"))
    first, second = codec.new(), codec.new()
    first.orientation_covariance[3] = 1.0
    first.header.stamp.sec = 1
    assert (list(second.orientation_covariance), second.header.stamp.sec) == ([0.0] * 9, 0)
