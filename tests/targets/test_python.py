"""Test the values of generated classes: round trips, and typed errors that do not change the region."""

from __future__ import annotations

import copy
import ctypes
import math
import pickle
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path
from types import ModuleType, SimpleNamespace
from typing import Any

import numpy as np
import pytest

from shmgen import runtime
from shmgen.config import Config
from shmgen.core import abi
from shmgen.core.model import TypeName
from shmgen.generator import pipeline
from shmgen.runtime.region import header

from ..support.build import committed_texts, module, put

DEFINITIONS = {
    "Joint": "string<=8 name\nint16 turns\nfloat32 torque # [Nm]\n",
    "Picture": "uint8 first\nuint8[5000] data\nuint8 last\n",
    "Robot": (
        "# A robot.\n"
        "uint8 IDLE=0\nstring GREETING='say \"hi\"'\nfloat64 HALF=0.5\n"
        "bool ready\nint8 mode 5\nuint64 serial\nstring<=10 label 'R1'\nwstring<=4 sign\n"
        "builtin_interfaces/Time stamp\nbuiltin_interfaces/Duration patience\n"
        "float64[3] axis [1.0, 0.0, 0.0]\nfloat32[2] thrust\n"
        "uint8[<=6000] image\nbool[<=3] flags\nstring<=3[<=2] tags\n"
        "builtin_interfaces/Time[2] window\nJoint arm\nJoint[<=3] joints\nJoint[2] wheels\n"
        "Picture[<=2] pictures\nbuiltin_interfaces/Duration[<=3] pauses\n"
    ),
}


@pytest.fixture(scope="module")
def demo(tmp_path_factory: pytest.TempPathFactory) -> ModuleType:
    folder = tmp_path_factory.mktemp("demo")
    put({f"msgs/demo_msgs/msg/{name}.msg": text for name, text in DEFINITIONS.items()}, folder)
    config = Config(folder, path=(folder / "msgs",), package="shm_demo", targets=("python",))
    put(pipeline.generate(config, ["demo_msgs"]), folder)
    return module(folder, "shm_demo", TypeName("demo_msgs", "msg", "Robot"))


def time(seconds: int, nanoseconds: int = 0) -> SimpleNamespace:
    return SimpleNamespace(sec=seconds, nanosec=nanoseconds)


def joint(**changes: Any) -> SimpleNamespace:
    return SimpleNamespace(**{"name": "j", "turns": 3, "torque": 1.5, **changes})


def robot(**changes: Any) -> SimpleNamespace:
    fields: dict[str, Any] = {
        "ready": True, "mode": -3, "serial": 2**64 - 1, "label": "grün", "sign": "☃",
        "stamp": time(0), "patience": time(2),
        "axis": [0.0, 1.0, 2.0], "thrust": [0.0, 0.0], "image": bytes(5000),
        "flags": [True, False], "tags": ["a", "bcd"],
        "window": [time(0), time(0)], "arm": joint(), "joints": [joint(name="one"), joint()],
        "wheels": [joint(), joint()], "pictures": [], "pauses": [],
    }  # fmt: skip
    return SimpleNamespace(**{**fields, **changes})


def test_new_object_has_defaults_and_constants(demo: ModuleType) -> None:
    msg = demo.Robot()
    assert (msg.mode, msg.label, list(msg.axis), msg.ready, len(msg.joints)) == (5, "R1", [1.0, 0.0, 0.0], False, 0)
    assert (demo.Robot.IDLE, demo.Robot.GREETING, demo.Robot.HALF) == (0, 'say "hi"', 0.5)


def test_fields_are_set_and_printed_as_in_ros(demo: ModuleType) -> None:
    msg = demo.Robot(label="x", joints=[demo.Joint(name="a"), demo.Joint(name="b")], image=b"\x01\x02", tags=["q"])
    msg.joints[1].turns = 7
    msg.axis[2] = 9.0
    assert ([joint.name for joint in msg.joints], msg.joints[1].turns) == (["a", "b"], 7)
    assert (list(msg.axis), bytes(msg.image), msg.tags) == ([1.0, 0.0, 9.0], b"\x01\x02", ["q"])
    assert "joints=[Joint(name='a', turns=0, torque=0.0), Joint(name='b', turns=7, torque=0.0)]" in repr(msg)


def test_misspelt_field_raises_attribute_error(demo: ModuleType) -> None:
    """Reject an unknown attribute, as ROS 2 does. Otherwise the value would be lost and a zero published."""
    msg = demo.Robot(joints=[demo.Joint()], pictures=[demo.Picture()])
    for place, word in ((msg, "labl"), (msg.arm, "turn"), (msg.joints[0], "torq"), (msg.stamp, "sek")):
        with pytest.raises(AttributeError, match=word):
            setattr(place, word, 1)
    with pytest.raises(AttributeError, match="picturs"):
        msg.picturs = []


class UserMessage(runtime.Message):
    """A message class written by a user, which may have additional attributes."""

    _fields_ = (("number", ctypes.c_int32),)
    _names_ = ("number",)


def test_copies_and_pickles_are_complete(demo: ModuleType) -> None:
    msg, own = demo.Robot(label="a", joints=[demo.Joint(name="j")], image=b"12"), UserMessage(number=3)
    own.remark = "mine"
    copy_functions: list[Callable[[Any], Any]] = [copy.copy, copy.deepcopy, lambda it: pickle.loads(pickle.dumps(it))]
    for duplicate_by in copy_functions:
        duplicate = duplicate_by(msg)
        duplicate.joints[0].turns = 5
        assert (duplicate.label, duplicate.joints[0].name, msg.joints[0].turns) == ("a", "j", 0)
        assert duplicate_by(msg.joints[0]) == msg.joints[0]
        assert (duplicate_by(own), duplicate_by(own).remark) == (own, "mine")


def test_docstring_contains_shapes_bounds_and_units(demo: ModuleType) -> None:
    assert "A robot." in demo.Robot.__doc__
    assert "joints (demo_msgs/Joint[<=3])" in demo.Robot.__doc__
    assert "torque (float32) [Nm]" in demo.Joint.__doc__
    assert "uint8[<=6000] image" in demo.Robot.__doc__


BAD = [
    ({"label": "x" * 11}, runtime.StringTooLong, "label"),
    ({"label": "a\0b"}, runtime.OutOfRange, "label"),
    ({"label": 5}, runtime.OutOfRange, "label"),
    ({"sign": "12345"}, runtime.StringTooLong, "sign"),
    ({"mode": 200}, runtime.OutOfRange, "mode"),
    ({"mode": 1.5}, runtime.OutOfRange, "mode"),
    ({"serial": -1}, runtime.OutOfRange, "serial"),
    ({"ready": "false"}, runtime.OutOfRange, "ready"),
    ({"patience": time(-1)}, runtime.OutOfRange, "patience"),
    ({"patience": time(2**32)}, runtime.OutOfRange, "patience"),
    ({"stamp": 5}, runtime.OutOfRange, "stamp"),
    ({"axis": [1.0, 2.0]}, runtime.CountExceeded, "axis"),
    ({"axis": [1.0, 2.0, "x"]}, runtime.OutOfRange, "axis[2]"),
    ({"image": bytes(6001)}, runtime.CountExceeded, "image"),
    ({"image": [1, 256]}, runtime.OutOfRange, "image[1]"),
    ({"flags": [True] * 4}, runtime.CountExceeded, "flags"),
    ({"tags": ["a", "abcd"]}, runtime.StringTooLong, "tags[1]"),
    ({"window": [time(0)]}, runtime.CountExceeded, "window"),
    ({"arm": joint(name="x" * 9)}, runtime.StringTooLong, "arm.name"),
    ({"arm": joint(turns=2**15)}, runtime.OutOfRange, "arm.turns"),
    ({"arm": SimpleNamespace(name="j", turns=1)}, runtime.OutOfRange, "arm.torque"),
    ({"arm": joint(torque=1e39)}, runtime.OutOfRange, "arm.torque"),
    ({"joints": [joint(), joint(), joint(turns=2**15)]}, runtime.OutOfRange, "joints[2].turns"),
    ({"joints": [joint()] * 4}, runtime.CountExceeded, "joints"),
    ({"joints": 5}, runtime.OutOfRange, "joints"),
    ({"wheels": [joint()]}, runtime.CountExceeded, "wheels"),
]


@pytest.mark.parametrize(("changes", "error", "path"), BAD, ids=[f"{path}-{next(iter(c))}" for c, _, path in BAD])
def test_rejected_publish_keeps_the_former_sample(
    demo: ModuleType, topic: str, changes: dict[str, Any], error: type[runtime.ValueRejected], path: str
) -> None:
    with demo.RobotPublisher(topic) as publisher, demo.RobotSubscriber(topic) as subscriber:
        publisher.publish(robot(serial=1))
        with pytest.raises(error) as raised:
            publisher.publish(robot(**changes))
        assert raised.value.path == path
        assert publisher.sequence == 1
        assert subscriber.read().serial == 1
        assert subscriber.read() is None
        publisher.publish(robot(serial=2))
        assert subscriber.read().serial == 2


BAD_MEMBERS = [
    ("label", "x" * 11), ("axis", [1.0]), ("joints", [joint()] * 4),
    ("mode", 200), ("mode", 2**40 + 5), ("mode", -129), ("mode", 1.5), ("mode", np.int64(200)), ("mode", "5"),
    ("serial", -1), ("serial", 2**64), ("ready", "false"), ("ready", 2), ("ready", None),
    ("image", [1, 256]), ("image", [-1]), ("image", np.array([256])), ("flags", ["false"]), ("thrust", [0, 1e300]),
]  # fmt: skip
"""Members of a Robot, each with an invalid value."""


@pytest.mark.parametrize(("name", "value"), BAD_MEMBERS)
def test_constructor_and_assignment_reject_bad_values(demo: ModuleType, name: str, value: Any) -> None:
    with pytest.raises(runtime.ValueRejected) as raised:
        demo.Robot(**{name: value})
    assert raised.value.path.partition("[")[0] == name
    former = demo.Robot(label="former")
    with pytest.raises(runtime.ValueRejected):
        setattr(former, name, value)
    assert former == demo.Robot(label="former")


@pytest.mark.parametrize(
    ("name", "index", "value", "path"),
    [
        ("thrust", 0, 1e300, "thrust[0]"),
        ("thrust", -1, "x", "thrust[-1]"),
        ("thrust", slice(None), [0, -1e39], "thrust[1]"),
        ("image", 1, 256, "image[1]"),
        ("image", 1, np.int16(-1), "image[1]"),
        ("image", slice(1, 3), [5, 300], "image[2]"),
        ("image", slice(None, None, -2), [1, -1], "image[0]"),
        ("image", slice(0, 2), np.array([0, 256]), "image[1]"),
        ("flags", 0, "false", "flags[0]"),
        ("flags", slice(0, 1), ["no"], "flags[0]"),
    ],
)
def test_element_assignment_rejects_bad_values(demo: ModuleType, name: str, index: Any, value: Any, path: str) -> None:
    msg = demo.Robot(image=bytes(3), flags=[True, True])
    with pytest.raises(runtime.OutOfRange) as raised:
        getattr(msg, name)[index] = value
    assert raised.value.path == path
    assert msg == demo.Robot(image=bytes(3), flags=[True, True])


def test_nested_assignment_rejects_bad_values(demo: ModuleType) -> None:
    msg = demo.Robot(joints=[demo.Joint()])
    for part in (msg.arm, msg.joints[0], msg.wheels[1]):
        with pytest.raises(runtime.OutOfRange, match="turns: 32768; int16 goes from -32768 to 32767"):
            part.turns = 2**15
        with pytest.raises(runtime.OutOfRange, match=r"torque: 1e\+39 is too large for float32"):
            part.torque = 1e39
        part.turns, part.torque = -(2**15), math.inf
        assert (part.turns, part.torque) == (-(2**15), math.inf)


def test_limits_infinity_and_numpy_values_are_accepted(demo: ModuleType, topic: str) -> None:
    msg = demo.Robot(mode=np.int8(-128), serial=2**64 - 1, ready=np.bool_(True), thrust=(-math.inf, math.nan))
    msg.arm.torque = np.float64(1.5)
    msg.image = np.arange(250, 256, dtype=np.uint8)
    msg.image[1:3] = np.array([0, 255])
    msg.flags = [True, 0, False]
    msg.flags[1:] = (1, np.bool_(False))
    with demo.RobotPublisher(topic) as publisher, demo.RobotSubscriber(topic) as subscriber:
        publisher.publish(msg)
        sample = subscriber.read()
    assert (sample.mode, sample.serial, sample.ready, sample.arm.torque) == (-128, 2**64 - 1, True, 1.5)
    assert (bytes(sample.image), list(sample.flags)) == (bytes([250, 0, 255, 253, 254, 255]), [True, True, False])
    assert sample.thrust[0] == -math.inf
    assert math.isnan(sample.thrust[1])


def test_long_messages_and_times_keep_their_values(demo: ModuleType) -> None:
    data = bytes(range(250)) * 20
    msg = demo.Robot(
        pictures=[SimpleNamespace(first=1, data=data, last=2), demo.Picture(first=3, data=data[::-1], last=4)],
        pauses=[time(1), time(2, 5_000_000)],
        patience=time(7, 9_000_000),
    )
    pictures = [(picture.first, bytes(picture.data), picture.last) for picture in msg.pictures]
    assert pictures == [(1, data, 2), (3, data[::-1], 4)]
    assert [(pause.sec, pause.nanosec) for pause in (*msg.pauses, msg.patience)] == [
        (1, 0),
        (2, 5_000_000),
        (7, 9_000_000),
    ]
    msg.pauses = []
    assert len(msg.pauses) == 0


def test_count_above_the_bound_raises(demo: ModuleType) -> None:
    msg = demo.Robot()
    msg._joints_count = 9
    with pytest.raises(runtime.CountExceeded, match="9 elements; the bound is 3"):
        msg.joints  # noqa: B018


@pytest.mark.slow
def test_generated_code_is_clean(tmp_path: Path) -> None:
    """Use the defaults of ruff and strict mypy, as in a user's repository."""
    put({path: text for path, text in committed_texts().items() if path.startswith("python/")}, tmp_path)
    folder = tmp_path / "python"
    subprocess.run([sys.executable, "-m", "ruff", "check", "--isolated", "--no-cache", folder], check=True)
    command = [sys.executable, "-m", "mypy", "--strict", "--config-file=", "--cache-dir=/dev/null", "-p", "shm_msgs"]
    subprocess.run(command, check=True, cwd=folder, stdout=sys.stderr)


@pytest.mark.parametrize("payload", [1, 56, 1904, 1905, 100_000])
@pytest.mark.parametrize("depth", [1, 2, 3, 4, 100])
def test_runtime_and_layout_agree_on_region_size(payload: int, depth: int) -> None:
    region_header = header.header_for("a/msg/B", 1, payload, depth)
    assert region_header.size == abi.region_size(payload, region_header.slots)
