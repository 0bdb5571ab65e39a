"""Times publishing and reading in one process, and compares each with a baseline in the same run.

    python benchmarks/publish.py

Prints nanoseconds per call and the ratio to the baseline of its group. Rounds are short and interleaved, so that other
load on the machine affects all cases alike. Targets: publishing a Pose takes at most 0.27 times the work by hand, or
1.5 times without the C extension. It is faster than ctypes assignment under the semaphore. Publishing 1 MiB takes at
most 1.1 times the copy alone. A read without a new sample takes at most 2 times the read of one integer from the map.
"""

from __future__ import annotations

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

ROUNDS = 1001
POSE = struct.Struct("<7d")
MIB = 1 << 20


class Point(runtime.Message):
    _table_version_ = 1
    _size_ = 24
    _steps_ = tuple((name, "float64", 8 * index, 8) for index, name in enumerate("xyz"))


class Quaternion(runtime.Message):
    _table_version_ = 1
    _size_ = 32
    _steps_ = tuple((name, "float64", 8 * index, 8) for index, name in enumerate("xyzw"))


class Pose(runtime.Message):
    _type_name_ = "geometry_msgs/msg/Pose"
    _digest_ = 0x0123456789ABCDEF
    _table_version_ = 1
    _size_ = 56
    _steps_ = (("position", Point, 0, 24), ("orientation", Quaternion, 24, 32))


class Image(runtime.Message):
    _type_name_ = "benchmark/msg/Image"
    _digest_ = 0xFEDCBA9876543210
    _table_version_ = 1
    _size_ = MIB
    _steps_ = (("data", "uint8", 0, 1, MIB),)


class PosePublisher(runtime.Publisher[Pose]):
    message_type = Pose


class PoseSubscriber(runtime.Subscriber[Pose]):
    message_type = Pose


class ImagePublisher(runtime.Publisher[Image]):
    message_type = Image


class ImageSubscriber(runtime.Subscriber[Image]):
    message_type = Image


def main() -> None:
    """Measure each group and print its table."""
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
    """Create a map and a semaphore for the baseline.

    Use multiprocessing's semaphore: it takes half the time of posix_ipc's.
    """
    name = "/" + runtime.region_name(topic)
    memory = posix_ipc.SharedMemory(name, posix_ipc.O_CREX, size=size)
    semaphore = SemLock(1, 1, 1, name, False)
    map = mmap.mmap(memory.fd, size)
    memory.close_fd()
    return map, semaphore


def _table(title: str, calls: int, work: dict[str, tuple[Callable[[Any], Any], Any]]) -> None:
    """Print a row for each case: a function and its argument. The first case is the baseline."""
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
