"""The libraries to compare, each as a function that returns the sender or the receiver of a stream of bytes.

Each function has the form `library(role, mode, size, name)`. For the `role` "send", it returns `send(ns)`. For
"receive", it returns `receive()`, which returns ns or None. A message has `size` bytes and begins with a time in
nanoseconds. `mode` selects how the receiver waits: "spin" returns None at once, "event" sleeps until a message arrives,
"poll" sleeps 1 ms between two checks.
"""

from __future__ import annotations

import mmap
import os
import socket
import struct
import time
from _multiprocessing import SemLock  # type: ignore[import-not-found]
from collections.abc import Callable
from contextlib import suppress
from types import SimpleNamespace
from typing import Any

import posix_ipc
from publish import PosePublisher, PoseSubscriber

from shmgen import runtime

from . import networks
from .payload import POSE, STAMP, decoder, encoder, pose, read_all_bytes


def shmgen(role: str, mode: str, size: int, name: str) -> Callable[..., Any]:
    """Return a sender or receiver that uses shmgen's generated classes.

    A message of 56 bytes is a Pose, a larger message is a stamp and an array.
    """
    publisher, subscriber = (PosePublisher, PoseSubscriber) if size == 56 else _block(size)
    topic = f"/{name}"
    if role == "send":
        writer = publisher(topic)
        if size == 56:
            message = pose()

            def send_pose(stamp: int) -> None:
                message.position.x = float(stamp)
                writer.publish(message)

            return send_pose
        message = SimpleNamespace(stamp=0, data=bytes(size - 8))

        def send(stamp: int) -> None:
            message.stamp = stamp
            writer.publish(message)

        return send
    reader = subscriber(topic)
    reads = {"spin": reader.read, "event": lambda: reader.wait(1), "poll": lambda: time.sleep(0.001) or reader.read()}
    read = reads[mode]

    def receive() -> int | None:
        message = read()
        if message is None:
            return None
        return int(message.position.x) if size == 56 else message.stamp

    return receive


def shmgen_in_place(role: str, mode: str, size: int, name: str) -> Callable[..., Any]:
    """Return a sender or receiver that uses shmgen's generated classes. The receiver reads the sample in the region."""
    if role == "send":
        return shmgen(role, mode, size, name)
    reader = _block(size)[1](f"/{name}")

    def receive() -> int | None:
        if mode == "event" and not reader.ready(1):
            return None
        with suppress(runtime.Overwritten), reader.borrow() as message:
            if message is not None:
                read_all_bytes(message.data)
                return int(message.stamp)
        return None

    return receive


def by_hand(role: str, mode: str, size: int, name: str) -> Callable[..., Any]:
    """Return a sender or receiver in hand-written Python: a lock, two slots, a sequence number, an event semaphore.

    The code uses the fastest means of Python: the semaphore of multiprocessing, and `pack_into` directly into the map.
    """
    region_size = 4096 + 2 * size
    memory = posix_ipc.SharedMemory("/" + name, posix_ipc.O_CREAT, size=region_size)
    lock, event = _semaphore(name, 1), _semaphore(f"{name}-event", 0)
    mapping = mmap.mmap(memory.fd, region_size)
    header = memoryview(mapping).cast("I")
    slot_offsets = [4096, 4096 + size]
    if role == "send":
        message, data = pose(), bytes(size - 8)
        number = 0

        def send(stamp: int) -> None:
            nonlocal number
            number += 1
            offset = slot_offsets[number & 1]
            lock.acquire(True, 0.01)
            if size == 56:
                p, q = message.position, message.orientation
                p.x = float(stamp)
                POSE.pack_into(mapping, offset, p.x, p.y, p.z, q.x, q.y, q.z, q.w)
            else:
                STAMP.pack_into(mapping, offset, stamp)
                mapping[offset + 8 : offset + size] = data
            header[0] = number
            lock.release()
            if header[1]:
                header[1] = 0
                event.release()

        return send
    decode = decoder(size)
    last = 0

    def receive() -> int | None:
        nonlocal last
        if mode == "poll":
            time.sleep(0.001)
        elif mode == "event" and header[0] == last:
            header[1] = 1
            if header[0] == last:
                event.acquire(True, 0.01)
        number = header[0]
        if number == last:
            return None
        last = number
        offset = slot_offsets[number & 1]
        lock.acquire(True, 0.01)
        data = mapping[offset : offset + size]
        lock.release()
        return decode(data)

    return receive


def udp(role: str, mode: str, size: int, name: str) -> Callable[..., Any]:
    """Return a sender or receiver that uses UDP over the loopback.

    Messages of more than 32 KiB are split, and the last piece completes the message.
    """
    return _datagrams(role, mode, size, socket.AF_INET, ("127.0.0.1", 20000 + sum(name.encode()) * 31 % 20000))


def unix(role: str, mode: str, size: int, name: str) -> Callable[..., Any]:
    """Return a sender or receiver that uses Unix datagrams.

    If the queue is full, the sender waits, while UDP drops the datagram.
    """
    return _datagrams(role, mode, size, socket.AF_UNIX, f"\0{name}")


def _datagrams(role: str, mode: str, size: int, family: int, address: Any) -> Callable[..., Any]:
    """Return a sender or receiver that uses one system call for each datagram.

    `settimeout` would add a system call before each receive.
    """
    piece = min(size, 32768)
    endpoint = socket.socket(family, socket.SOCK_DGRAM)
    if role == "send":
        endpoint.connect(address)
        encode = encoder(piece)

        def send(stamp: int) -> None:
            data = encode(stamp)
            for _ in range(size // piece):
                endpoint.send(data)

        return send
    endpoint.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, 4 << 20)
    endpoint.bind(address)
    endpoint.setsockopt(socket.SOL_SOCKET, socket.SO_RCVTIMEO, struct.pack("@ll", 1, 0))
    endpoint.setblocking(mode == "event")
    decode = decoder(piece)
    piece_count, last_stamp = 0, -1

    def receive() -> int | None:
        nonlocal piece_count, last_stamp
        try:
            stamp = decode(endpoint.recv(piece))
        except OSError:
            return None
        piece_count = piece_count + 1 if stamp == last_stamp else 1
        last_stamp = stamp
        return stamp if piece_count == size // piece else None

    return receive


LIBRARIES: dict[str, Callable[..., Callable[..., Any]]] = {
    "shmgen": shmgen,
    "shmgen in place": shmgen_in_place,
    "by hand": by_hand,
    "UDP": udp,
    "Unix datagram": unix,
    **networks.LIBRARIES,
}


def _semaphore(name: str, value: int) -> SemLock:
    """Create the semaphore, or open it if the other process has created it."""
    try:
        return SemLock(1, value, 1, f"/{name}", False)
    except FileExistsError:
        return SemLock._rebuild(0, 1, 1, f"/{name}")


def _block(size: int) -> tuple[Any, Any]:
    """Return publisher and subscriber classes of a message with a stamp and an array, like generated classes.

    The message has the fields `uint64 stamp` and `uint8[size - 8] data`.
    """
    body = {
        "_type_name_": "benchmark/msg/Block",
        "_digest_": size,
        "_table_version_": 1,
        "_size_": size,
        "_steps_": (("stamp", "uint64", 0, 8), ("data", "uint8", 8, 1, size - 8)),
    }
    message = type("Block", (runtime.Message,), body)
    bases = (runtime.Publisher, runtime.Subscriber)
    return tuple(type(f"Block{base.__name__}", (base,), {"message_type": message}) for base in bases)


def remove(name: str) -> None:
    """Remove the files of a run from /dev/shm."""
    for file in os.listdir("/dev/shm"):
        if name in file:
            os.unlink(f"/dev/shm/{file}")
