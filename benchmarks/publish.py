"""Times publishing and reading in one process, each beside a floor in the same run.

    python benchmarks/publish.py

Prints nanoseconds a call and the ratio to the floor of its group. Rounds are short and interleaved, so that what else
the machine does meets all alike. Targets: publishing a Pose at most 0.8 x the work by hand (1.5 x without the extension
in C), and ahead of ctypes assignment under the semaphore; 1 MiB at most 1.1 x the copy alone; an idle read at most
2 x a look at one word.
"""

from __future__ import annotations

import ctypes
import mmap
import os
import statistics
import struct
import sys
import time
from _multiprocessing import SemLock  # type: ignore[import-not-found]
from collections.abc import Callable
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import posix_ipc

from shmgen import runtime
from shmgen.runtime import values

ROUNDS = 1001
POSE = struct.Struct("<7d")
MIB = 1 << 20


class Point(runtime.Message):
    _pack_ = 1
    _fields_ = [(name, ctypes.c_double) for name in ("x", "y", "z")]  # noqa: RUF012
    _names_ = ("x", "y", "z")


class Quaternion(runtime.Message):
    _pack_ = 1
    _fields_ = [(name, ctypes.c_double) for name in ("x", "y", "z", "w")]  # noqa: RUF012
    _names_ = ("x", "y", "z", "w")


class Pose(runtime.Message):
    _pack_ = 1
    _fields_ = [("position", Point), ("orientation", Quaternion)]  # noqa: RUF012
    _type_name_ = "geometry_msgs/msg/Pose"
    _digest_ = 0x0123456789ABCDEF
    _names_ = ("position", "orientation")

    @staticmethod
    def _encode(message: Any, into: bytearray | memoryview, at: int, late: runtime.Late) -> None:
        try:
            position = message.position
            orientation = message.orientation
            POSE.pack_into(
                into, at, position.x, position.y, position.z, orientation.x, orientation.y, orientation.z, orientation.w
            )
        except values.ENCODE_ERRORS as error:
            values.explain(message, (), error)


class Image(runtime.Message):
    _pack_ = 1
    _fields_ = [("data", ctypes.c_uint8 * MIB)]  # noqa: RUF012
    _type_name_ = "benchmark/msg/Image"
    _digest_ = 0xFEDCBA9876543210
    _names_ = ("data",)

    @staticmethod
    def _encode(message: Any, into: bytearray | memoryview, at: int, late: runtime.Late) -> None:
        late.append((at, MIB, values.numbers(message.data, "B", 1, "data", exactly=MIB)))


class PosePublisher(runtime.Publisher[Pose]):
    message_type = Pose


class PoseSubscriber(runtime.Subscriber[Pose]):
    message_type = Pose


class ImagePublisher(runtime.Publisher[Image]):
    message_type = Image


class ImageSubscriber(runtime.Subscriber[Image]):
    message_type = Image


def main() -> None:
    """Measures each group and prints its table."""
    topics = [f"/shmgen_benchmark_{os.getpid()}/{name}" for name in ("pose", "image", "hand", "memory")]
    try:
        print(f"Python {sys.version.split()[0]}, {os.uname().machine}, {os.cpu_count()} cores; medians of {ROUNDS}")
        _pose(*topics[:1], topics[2])
        _image(topics[1], topics[3])
    finally:
        for file in Path("/dev/shm").glob(f"*shmgen_benchmark_{os.getpid()}.*"):
            file.unlink()


def _pose(topic: str, hand_topic: str) -> None:
    point, turn = SimpleNamespace(x=1.0, y=2.0, z=3.0), SimpleNamespace(x=0.0, y=0.0, z=0.0, w=1.0)
    message = SimpleNamespace(position=point, orientation=turn)
    ours = Pose(position=Point(x=1.0), orientation=Quaternion(w=1.0))
    map, semaphore = _by_hand(hand_topic, 4096)
    acquire, release = semaphore.acquire, semaphore.release

    def by_hand(message: Any) -> None:
        acquire(True, 0.01)
        p, q = message.position, message.orientation
        POSE.pack_into(map, 256, p.x, p.y, p.z, q.x, q.y, q.z, q.w)
        release()

    naive = Pose.from_buffer(map, 256)

    def assigned(message: Any) -> None:
        with semaphore:
            naive.position.x = message.position.x
            naive.position.y = message.position.y
            naive.position.z = message.position.z
            naive.orientation.x = message.orientation.x
            naive.orientation.y = message.orientation.y
            naive.orientation.z = message.orientation.z
            naive.orientation.w = message.orientation.w

    words = memoryview(map).cast("I")

    def look(word: int) -> int:
        return words[word]

    with PosePublisher(topic) as publisher, PoseSubscriber(topic) as subscriber, PoseSubscriber(topic) as idle:
        publisher.publish(message)
        idle.read()

        def exchange(message: Any) -> None:
            publisher.publish(message)
            subscriber.read()

        _table(
            "Publish a Pose (56 bytes)",
            400,
            {
                "lock (SemLock) + pack_into the map, by hand": (by_hand, message),
                "ctypes assignment under `with semaphore`": (assigned, message),
                "publish(any object)": (publisher.publish, message),
                "publish(Pose)": (publisher.publish, ours),
                "publish(any object) + read()": (exchange, message),
            },
        )
        _table("Nothing new", 1000, {"a look at one word": (look, 33), "read()": (lambda _: idle.read(), None)})


def _image(topic: str, hand_topic: str) -> None:
    data = bytearray(os.urandom(MIB))
    message, ours = SimpleNamespace(data=data), Image.from_buffer_copy(data)
    map, _ = _by_hand(hand_topic, 2 * MIB + 4096)
    places = [slice(256, 256 + MIB), slice(256 + MIB + 64, 256 + 2 * MIB + 64)]
    turn = [0]

    def copy(data: bytearray) -> None:
        turn[0] ^= 1
        map[places[turn[0]]] = data

    with ImagePublisher(topic) as publisher, ImageSubscriber(topic) as subscriber:

        def read_new(_: None) -> None:
            subscriber._end.last = 0
            subscriber.read()

        _table(
            "Publish 1 MiB of uint8",
            4,
            {
                "copy into two mapped slots in turn (memcpy)": (copy, data),
                "publish(any object with a bytearray)": (publisher.publish, message),
                "publish(Image)": (publisher.publish, ours),
            },
        )
        _table(
            "Read 1 MiB of uint8",
            4,
            {"copy out to bytes": (map.__getitem__, places[0]), "read()": (read_new, None)},
        )


def _by_hand(topic: str, size: int) -> tuple[mmap.mmap, SemLock]:
    """The quickest that Python has: multiprocessing's semaphore takes half of the time of posix_ipc's."""
    name = "/" + runtime.region_name(topic)
    memory = posix_ipc.SharedMemory(name, posix_ipc.O_CREX, size=size)
    semaphore = SemLock(1, 1, 1, name, False)
    map = mmap.mmap(memory.fd, size)
    memory.close_fd()
    return map, semaphore


def _table(title: str, calls: int, work: dict[str, tuple[Callable[[Any], Any], Any]]) -> None:
    """Prints a row for each work, a function and its argument; the first is the floor."""
    times: dict[str, list[float]] = {name: [] for name in work}
    for _ in range(ROUNDS):
        for name, (call, argument) in work.items():
            start = time.perf_counter_ns()
            for _ in range(calls):
                call(argument)
            times[name].append((time.perf_counter_ns() - start) / calls)
    print(f"\n{title:<48}{'ns':>12}{'ratio':>8}")
    floor = times[next(iter(work))]
    for name, measured in times.items():
        ratio = statistics.median(mine / base for mine, base in zip(measured, floor, strict=True))
        print(f"  {name:<46}{statistics.median(measured):>12,.0f}{ratio:>8.2f}")


if __name__ == "__main__":
    main()
