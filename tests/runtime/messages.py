"""Define message classes like the generated ones, and the jobs of a second process."""

from __future__ import annotations

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
from shmgen.runtime.reference import claim  # noqa: E402
from shmgen.runtime.region import header as h  # noqa: E402
from tests.support.region_of import region_of  # noqa: E402

WHY_NOT = "shmgen was installed without gcc or Python's headers: apt-get install gcc python3-dev; pip install -e ."
if "t" in sys.abiflags:
    WHY_NOT = "a free-threaded Python has no extension in C"
POSE = struct.Struct("<7d")
LONG = 6000


class Point(runtime.Message):
    _table_version_ = 1
    _size_ = 24
    _steps_ = (("x", "float64", 0, 8), ("y", "float64", 8, 8), ("z", "float64", 16, 8))


class Quaternion(runtime.Message):
    _table_version_ = 1
    _size_ = 32
    _steps_ = (("x", "float64", 0, 8), ("y", "float64", 8, 8), ("z", "float64", 16, 8), ("w", "float64", 24, 8))
    _defaults_ = (("w", 1.0),)


class Pose(runtime.Message):
    _type_name_ = "geometry_msgs/msg/Pose"
    _digest_ = 0x0123456789ABCDEF
    _table_version_ = 1
    _size_ = 56
    _steps_ = (("position", Point, 0, 24), ("orientation", Quaternion, 24, 32))


class Scan(runtime.Message):
    """A message with a number, a fixed long array, a bounded long array and text."""

    _type_name_ = "test_msgs/msg/Scan"
    _digest_ = 0x5CA9
    _table_version_ = 1
    _size_ = 32 + 9 * LONG
    _steps_ = (
        ("id", "uint32", 0, 4),
        ("ranges", "float64", 8, 8, LONG),
        ("data", "uint8", 12 + 8 * LONG, 1, LONG, 8 + 8 * LONG),
        ("name", "utf-8", 12 + 9 * LONG, 17),
    )


class PosePublisher(runtime.Publisher[Pose]):
    message_type = Pose


class PoseSubscriber(runtime.Subscriber[Pose]):
    message_type = Pose


class ScanPublisher(runtime.Publisher[Scan]):
    message_type = Scan


class ScanSubscriber(runtime.Subscriber[Scan]):
    message_type = Scan


def pose(x: float) -> SimpleNamespace:
    """Return a message of another class with one number in all fields, so that a torn copy is detectable."""
    return SimpleNamespace(position=SimpleNamespace(x=x, y=x, z=x), orientation=SimpleNamespace(x=x, y=x, z=x, w=x))


def is_whole(message: Pose) -> bool:
    return len(set(POSE.unpack(bytes(message)))) == 1


def print_line(line: object) -> None:
    print(line, flush=True)


def main(job: str, topic: str, depth: int = 1) -> None:
    """Do the job of the second process. Print "ready" at the start, and exit at the end of the input."""
    claim._STOOD_STILL = math.inf  # like the fixture in_time
    match job:
        case "publish":
            with PosePublisher(topic, depth=depth) as publisher:
                print_line("ready")
                for line in sys.stdin:
                    publisher.publish(pose(float(line)))
                    print_line(publisher.sequence)
        case "read":
            with PoseSubscriber(topic, depth=depth) as subscriber:
                print_line("ready")
                for _ in sys.stdin:
                    message = subscriber.wait(5)
                    print_line(message and message.position.x)
        case "await":
            subscribers = [PoseSubscriber(f"{topic}/t{number}") for number in range(depth)]
            print_line("ready")
            while True:
                for subscriber in runtime.ready_any(subscribers, 60):
                    print_line(subscriber.read().position.x)
        case "flood":
            with PosePublisher(topic, depth=depth, lock_timeout=0) as publisher:
                print_line("ready")
                end = time.monotonic() + 20
                number = 1
                while time.monotonic() < end:
                    with suppress(runtime.LockTimeout):  # only where the lock is required: nothing was published
                        publisher.publish(pose(float(number)))
                        number += 1
        case "inside":
            with PoseSubscriber(topic, depth=depth) as subscriber:
                words = region_of(subscriber).words
                assert region_of(subscriber).semaphore.acquire()
                words[h.LOCK_COUNT] += 1
                words[h.LOCK_HOLDER] = os.getpid()
                print_line("ready")
                sys.stdin.read()
        case "hold":
            with PoseSubscriber(topic, depth=depth) as subscriber:
                region_of(subscriber).semaphore.acquire()
                print_line("ready")
                sys.stdin.read()
                region_of(subscriber).semaphore.post()
        case _:
            raise SystemExit(job)


if __name__ == "__main__":
    main(sys.argv[1], sys.argv[2], *map(int, sys.argv[3:]))
