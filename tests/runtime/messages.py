"""Message classes as the generator writes them, by hand, and the work of a second process."""

from __future__ import annotations

import ctypes
import math
import os
import struct
import sys
import time
from contextlib import suppress
from pathlib import Path
from types import SimpleNamespace

sys.path.append(str(Path(__file__).parents[2]))
from tests.support import machine

machine.pretend()
from shmgen import runtime  # noqa: E402
from shmgen.runtime.messages import values  # noqa: E402
from shmgen.runtime.reference import claim  # noqa: E402
from shmgen.runtime.region import header as h  # noqa: E402
from tests.support.region_of import region_of  # noqa: E402

WHY_NOT = "shmgen was installed without gcc or Python's headers: apt-get install gcc python3-dev; pip install -e ."
if "t" in sys.abiflags:
    WHY_NOT = "a free-threaded Python has no extension in C"
POSE = struct.Struct("<7d")
SCAN = struct.Struct("<I12xI16sB")
LONG = 6000


class Point(runtime.Message):
    _pack_ = 1
    _fields_ = [("x", ctypes.c_double), ("y", ctypes.c_double), ("z", ctypes.c_double)]  # noqa: RUF012
    _names_ = ("x", "y", "z")

    @staticmethod
    def _encode(message, into, at, late):
        try:
            struct.pack_into("<3d", into, at, message.x, message.y, message.z)
        except values.ENCODE_ERRORS as error:
            values.explain(message, (("x", "d"), ("y", "d"), ("z", "d")), error)

    @staticmethod
    def _decode(data, at, message):
        message.x, message.y, message.z = struct.unpack_from("<3d", data, at)


class Quaternion(runtime.Message):
    _pack_ = 1
    _fields_ = [(name, ctypes.c_double) for name in ("x", "y", "z", "w")]  # noqa: RUF012
    _names_ = ("x", "y", "z", "w")

    def _set_defaults(self):
        self.w = 1.0


class Pose(runtime.Message):
    _pack_ = 1
    _fields_ = [("position", Point), ("orientation", Quaternion)]  # noqa: RUF012
    _type_name_ = "geometry_msgs/msg/Pose"
    _digest_ = 0x0123456789ABCDEF
    _names_ = ("position", "orientation")
    _rows = tuple((f"position.{a}", "d") for a in "xyz") + tuple((f"orientation.{a}", "d") for a in "xyzw")

    def _set_defaults(self):
        self.orientation.w = 1.0

    @staticmethod
    def _encode(message, into, at, late):
        try:
            p, q = message.position, message.orientation
            POSE.pack_into(into, at, p.x, p.y, p.z, q.x, q.y, q.z, q.w)
        except values.ENCODE_ERRORS as error:
            values.explain(message, Pose._rows, error)

    @staticmethod
    def _decode(data, at, message):
        p, q = message.position, message.orientation
        p.x, p.y, p.z, q.x, q.y, q.z, q.w = POSE.unpack_from(data, at)


class Scan(runtime.Message):
    """A number, a fixed long array, a bounded long array between short members, and text."""

    _pack_ = 1
    _fields_ = [  # noqa: RUF012
        ("id", ctypes.c_uint32),
        ("_pad0", ctypes.c_uint8 * 4),
        ("_ranges", ctypes.c_double * LONG),
        ("_data_count", ctypes.c_uint32),
        ("_data", ctypes.c_uint8 * LONG),
        ("_name", ctypes.c_char * 17),
        ("_pad1", ctypes.c_uint8 * 3),
    ]
    _type_name_ = "test_msgs/msg/Scan"
    _digest_ = 0x5CA9
    _names_ = ("id", "ranges", "data", "name")
    ranges = runtime.Elements(8, ctypes.c_double, LONG)
    data = runtime.Elements(12 + 8 * LONG, ctypes.c_uint8, LONG, 8 + 8 * LONG)
    name = runtime.Text(12 + 9 * LONG, 17, 16, values.text, values.from_text)

    @staticmethod
    def _encode(message, into, at, late):
        try:
            ranges = values.numbers(message.ranges, "d", 8, "ranges", exactly=LONG)
            data = values.numbers(message.data, "B", 1, "data", at_most=LONG)
            struct.pack_into("<I4x", into, at, message.id)
            late.append((at + 8, 8 * LONG, ranges))
            struct.pack_into("<I", into, at + 8 + 8 * LONG, len(data))
            late.append((at + 12 + 8 * LONG, LONG, data))
            struct.pack_into("<17s3x", into, at + 12 + 9 * LONG, values.text(message.name, 16, "name"))
        except values.ENCODE_ERRORS as error:
            values.explain(message, (("id", "I"),), error)

    @staticmethod
    def _decode(data, at, message):
        (message.id,) = struct.unpack_from("<I", data, at)
        message.ranges = values.from_numbers(data[at + 8 : at + 8 + 8 * LONG], "d", message.ranges)
        start = at + 8 + 8 * LONG
        count = values.count(struct.unpack_from("<I", data, start)[0], LONG, "data")
        message.data = values.from_numbers(data[start + 4 : start + 4 + count], "B", message.data)
        message.name = values.from_text(data[start + 4 + LONG : start + 4 + LONG + 17])


class PosePublisher(runtime.Publisher[Pose]):
    message_type = Pose


class PoseSubscriber(runtime.Subscriber[Pose]):
    message_type = Pose


class ScanPublisher(runtime.Publisher[Scan]):
    message_type = Scan


class ScanSubscriber(runtime.Subscriber[Scan]):
    message_type = Scan


def pose(x: float) -> SimpleNamespace:
    """A foreign message, of one number in each field, so that a torn copy shows."""
    return SimpleNamespace(position=SimpleNamespace(x=x, y=x, z=x), orientation=SimpleNamespace(x=x, y=x, z=x, w=x))


def whole(message: Pose) -> bool:
    return len(set(POSE.unpack(bytes(message)))) == 1


def say(line: object) -> None:
    print(line, flush=True)


def main(work: str, topic: str, depth: int = 1) -> None:
    """What the other process does; it says a line when it is ready, and ends when its input does."""
    claim._STOOD_STILL = math.inf  # as in_time does for the tests
    match work:
        case "publish":
            with PosePublisher(topic, depth=depth) as publisher:
                say("ready")
                for line in sys.stdin:
                    publisher.publish(pose(float(line)))
                    say(publisher.sequence)
        case "read":
            with PoseSubscriber(topic, depth=depth) as subscriber:
                say("ready")
                for _ in sys.stdin:
                    message = subscriber.wait(5)
                    say(message and message.position.x)
        case "await":
            subscribers = [PoseSubscriber(f"{topic}/t{number}") for number in range(depth)]
            say("ready")
            while True:
                for one in runtime.ready_any(subscribers, 60):
                    say(one.read().position.x)
        case "flood":
            with PosePublisher(topic, depth=depth, lock_timeout=0) as publisher:
                say("ready")
                end = time.monotonic() + 20
                number = 1
                while time.monotonic() < end:
                    with suppress(runtime.LockTimeout):  # where the lock is needed: nothing was published
                        publisher.publish(pose(float(number)))
                        number += 1
        case "inside":
            with PoseSubscriber(topic, depth=depth) as subscriber:
                words = region_of(subscriber).words
                assert region_of(subscriber).semaphore.acquire()
                words[h.LOCK_COUNT] += 1
                words[h.LOCK_HOLDER] = os.getpid()
                say("ready")
                sys.stdin.read()
        case "hold":
            with PoseSubscriber(topic, depth=depth) as subscriber:
                region_of(subscriber).semaphore.acquire()
                say("ready")
                sys.stdin.read()
                region_of(subscriber).semaphore.post()
        case _:
            raise SystemExit(work)


if __name__ == "__main__":
    main(sys.argv[1], sys.argv[2], *map(int, sys.argv[3:]))
