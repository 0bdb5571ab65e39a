"""Times publishing and reading of four ordinary messages, and compares with hand-written code that packs the bytes.

    python benchmarks/messages.py

The hand-written code acquires a semaphore, calls struct's pack_into from all attributes directly into shared memory,
and releases the semaphore. It is the fastest way in Python without a library. Targets: publish() takes at most 0.6
times the work by hand for each message, and read_into() takes at most 1.5 us.
"""

from __future__ import annotations

import atexit
import mmap
import os
import shutil
import statistics
import struct
import subprocess
import sys
import tempfile
import time
from _multiprocessing import SemLock  # type: ignore[import-not-found]
from collections.abc import Callable
from pathlib import Path
from types import SimpleNamespace
from typing import Any

GENERATED = Path(tempfile.mkdtemp())
atexit.register(shutil.rmtree, GENERATED)
subprocess.run(
    [sys.executable, "-m", "shmgen", "generate", "--quiet", "-t", "python", "-o", GENERATED],
    cwd=Path(__file__).parents[1],
    check=True,
)
sys.path.insert(0, f"{GENERATED}/python")
from shm_msgs.geometry_msgs import msg as geometry  # type: ignore[import-not-found]  # noqa: E402
from shm_msgs.sensor_msgs import msg as sensor  # type: ignore[import-not-found]  # noqa: E402

ROUNDS, CALLS = 301, 200
TOPIC = f"/shmgen_benchmark_{os.getpid()}"
POINT = SimpleNamespace(x=1.0, y=2.0, z=3.0)
TURN = SimpleNamespace(x=0.0, y=0.0, z=0.0, w=1.0)
HEADER = SimpleNamespace(stamp=SimpleNamespace(sec=5, nanosec=6), frame_id="base_link")
POSE = SimpleNamespace(position=POINT, orientation=TURN)
NAMES = [f"joint_{number}" for number in range(6)]
NUMBERS = [0.5] * 6
NINE = [0.0] * 9
EXAMPLES: dict[str, tuple[Any, Any]] = {
    "Pose": (geometry, POSE),
    "PoseStamped": (geometry, SimpleNamespace(header=HEADER, pose=POSE)),
    "Imu": (
        sensor,
        SimpleNamespace(
            header=HEADER,
            orientation=TURN,
            orientation_covariance=NINE,
            angular_velocity=POINT,
            angular_velocity_covariance=NINE,
            linear_acceleration=POINT,
            linear_acceleration_covariance=NINE,
        ),
    ),
    "JointState": (
        sensor,
        SimpleNamespace(header=HEADER, name=NAMES, position=NUMBERS, velocity=NUMBERS, effort=NUMBERS),
    ),
}
_pose = struct.Struct("<7d").pack_into
_stamped = struct.Struct("<iI33s7x7d").pack_into
_imu = struct.Struct("<iI33s7x4d9d3d9d3d9d").pack_into
_head = struct.Struct("<iI33s").pack_into
_names = struct.Struct("<I" + 8 * "81s").pack_into
_numbers = struct.Struct("<I4x8d").pack_into


def by_hand_pose(map: mmap.mmap, m: Any) -> None:
    p, q = m.position, m.orientation
    _pose(map, 256, p.x, p.y, p.z, q.x, q.y, q.z, q.w)


def by_hand_stamped(map: mmap.mmap, m: Any) -> None:
    h, p, q = m.header, m.pose.position, m.pose.orientation
    frame = h.frame_id.encode()
    _stamped(map, 256, h.stamp.sec, h.stamp.nanosec, frame, p.x, p.y, p.z, q.x, q.y, q.z, q.w)


def by_hand_imu(map: mmap.mmap, m: Any) -> None:
    h, q, v, a = m.header, m.orientation, m.angular_velocity, m.linear_acceleration
    _imu(
        map, 256, h.stamp.sec, h.stamp.nanosec, h.frame_id.encode(), q.x, q.y, q.z, q.w, *m.orientation_covariance,
        v.x, v.y, v.z, *m.angular_velocity_covariance, a.x, a.y, a.z, *m.linear_acceleration_covariance,
    )  # fmt: skip


def by_hand_joints(map: mmap.mmap, m: Any) -> None:
    h, name = m.header, m.name
    _head(map, 256, h.stamp.sec, h.stamp.nanosec, h.frame_id.encode())
    _names(map, 300, len(name), *[one.encode() for one in name], *[b""] * (8 - len(name)))
    at = 952
    for numbers in (m.position, m.velocity, m.effort):
        _numbers(map, at, len(numbers), *numbers, *[0.0] * (8 - len(numbers)))
        at += 72


BY_HAND: tuple[Callable[[mmap.mmap, Any], None], ...] = (by_hand_pose, by_hand_stamped, by_hand_imu, by_hand_joints)


def main() -> None:
    print(f"Python {sys.version.split()[0]}, {os.uname().machine}, {os.cpu_count()} cores; medians of {ROUNDS}")
    print(f"\n{'':<24}{'by hand':>10}{'publish':>10}{'ratio':>8}{'read_into':>12}")
    lock, map = SemLock(1, 1, 1, f"/{TOPIC[1:]}", True), mmap.mmap(-1, 4096)
    acquire, release = lock.acquire, lock.release
    try:
        for (name, (package, message)), pack in zip(EXAMPLES.items(), BY_HAND, strict=True):
            row(name, package, message, lambda m, pack=pack: (acquire(True, 0.01), pack(map, m), release()))
    finally:
        for file in Path("/dev/shm").glob(f"*{TOPIC[1:]}*"):
            file.unlink()


def row(name: str, package: Any, message: Any, by_hand: Callable[[Any], Any]) -> None:
    topic = f"{TOPIC}/{name}"
    with (
        getattr(package, f"{name}Publisher")(topic) as publisher,
        getattr(package, f"{name}Subscriber")(topic) as subscriber,
    ):
        publisher.publish(message)
        into = _copied(message)

        def read_into(into: Any) -> None:
            subscriber._end.last = 0
            subscriber.read_into(into)

        hand, ours, back = [], [], []
        for _ in range(ROUNDS):
            hand.append(_ns(by_hand, message))
            ours.append(_ns(publisher.publish, message))
            back.append(_ns(read_into, into))
    ratio = statistics.median(mine / floor for mine, floor in zip(ours, hand, strict=True))
    middle = [statistics.median(times) for times in (hand, ours, back)]
    print(f"{name:<24}{middle[0]:>10,.0f}{middle[1]:>10,.0f}{ratio:>8.2f}{middle[2]:>12,.0f}")


def _ns(call: Callable[[Any], Any], argument: Any) -> float:
    start = time.perf_counter_ns()
    for _ in range(CALLS):
        call(argument)
    return (time.perf_counter_ns() - start) / CALLS


def _copied(message: Any) -> Any:
    """Return a deep copy of the message."""
    if isinstance(message, SimpleNamespace):
        return SimpleNamespace(**{name: _copied(value) for name, value in vars(message).items()})
    return list(message) if isinstance(message, list) else message


if __name__ == "__main__":
    main()
