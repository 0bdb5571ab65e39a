"""Helpers that backends share: the DDS domain, decoding, and waiting for a server or for threads."""

from __future__ import annotations

import os
import sys
import threading
import time
from collections.abc import Callable, Iterable
from typing import Any, TypeVar

from shmgen.bridge.backend import MessageSink, NoAnswer, Node, Wire
from shmgen.bridge.codec.direct import WireFormat
from shmgen.config.keys import MAX_DOMAIN

_POLL_INTERVAL = 0.01
"""Seconds between two checks for a server."""
SHUTDOWN_TIMEOUT = 0.4
"""Seconds that all threads of a backend together have to finish at shutdown."""
_MOST_PEERS = 1000
"""Maximum number of peers that one endpoint remembers, including peers that have left."""

T = TypeVar("T")
V = TypeVar("V")


def domain_without_ros(node: Node, backend: str) -> int:
    """Return the DDS domain to join, from shmgen.toml or ROS_DOMAIN_ID. Raises ValueError if the number is invalid."""
    text = os.environ.get("ROS_DOMAIN_ID", "").strip() if node.domain is None else str(node.domain)
    if (not text.isdecimal() and text) or int(text or 0) > MAX_DOMAIN:
        where = "ROS_DOMAIN_ID" if node.domain is None else "shmgen.toml"
        raise ValueError(f"{backend}: a domain is a number from 0 to {MAX_DOMAIN}, not {text!r} as {where} says")
    return int(text or 0)


def from_bytes(
    wire: Wire, decode: Callable[[bytes], Any], wire_format: WireFormat, sink: MessageSink
) -> Callable[[bytes], None]:
    """Return a function that decodes the bytes of a message and passes the message to `sink`.

    If the bytes cannot be decoded, the function calls `sink.reject`. If the type has a direct conversion from ROS bytes
    to sample bytes, the function uses it instead of `decode`.
    """
    decode_directly = wire.direct.decoder_to_sample(wire_format) if wire.direct else None

    def take(data: bytes) -> None:
        if len(data) > wire.largest:
            sink.reject(f"{len(data):,} bytes, and more than {wire.largest:,} do not fit its region")
            return
        try:
            message = (decode_directly and decode_directly(data)) or decode(data)
        except ValueError as error:
            sink.reject(str(error))
            return
        sink.take(message)

    return take


def remember_bounded(values: dict[T, V], peer: T, value: V) -> None:
    """Set `values[peer]` to `value`. If `values` then has more than 1000 peers, remove the oldest.

    The limit bounds the memory of a bridge that runs for months while peers connect and disconnect.
    """
    values[peer] = value
    if len(values) > _MOST_PEERS:
        del values[next(iter(values))]


def await_server(is_connected: Callable[[], bool], timeout: float) -> float:
    """Wait for a server and return the deadline of the call on the monotonic clock, in seconds.

    Raises NoAnswer if no server appears within `timeout` seconds.
    """
    deadline = time.monotonic() + timeout
    while not is_connected():
        if time.monotonic() >= deadline:
            raise NoAnswer(f"no server within {timeout:g} s")
        time.sleep(_POLL_INTERVAL)
    return deadline


def join_all(threads: Iterable[threading.Thread]) -> bool:
    """Wait for the threads, up to SHUTDOWN_TIMEOUT in total. Return True if all have ended."""
    deadline, waiting = time.monotonic() + SHUTDOWN_TIMEOUT, list(threads)
    for thread in waiting:
        thread.join(max(0.0, deadline - time.monotonic()))
    return not any(thread.is_alive() for thread in waiting)


def end_at_once() -> None:
    """End the process at once with status 0, without running destructors. Register this function with atexit.

    Use it if a thread is still inside a ROS library, whose destructors would crash the process.
    """
    sys.stdout.flush()
    sys.stderr.flush()
    os._exit(0)
