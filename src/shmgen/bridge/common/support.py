"""Helpers that backends share: the DDS domain, decoding, and waiting for a server or for threads."""

from __future__ import annotations

import os
import threading
import time
from collections.abc import Callable, Iterable
from concurrent.futures import Future, TimeoutError
from contextlib import suppress
from typing import Any, TypeVar

from shmgen.bridge.backend import ErrorSink, NoAnswer, Node, Wire
from shmgen.bridge.common.counters import Counters, describe
from shmgen.config.keys import MAX_DOMAIN
from shmgen.runtime import Message, Time, ValueRejected

_POLL_INTERVAL = 0.01
"""Seconds between two checks for a server."""
_SERVER_POLL_INTERVAL = 0.1
"""Seconds between two checks that the server of a call is still present."""
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
        raise ValueError(f"{backend}: the domain in {where} must be a number from 0 to {MAX_DOMAIN}, not {text!r}")
    return int(text or 0)


def from_bytes(
    wire: Wire,
    decode: Callable[[bytes], Any],
    take: Callable[[Any], None],
    errors: ErrorSink,
    is_ros1: bool = False,
) -> Callable[[bytes], None]:
    """Return a function that decodes a serialized ROS message and passes the message to `take`.

    If the bytes are invalid or too long, the function calls `errors.reject`. If `wire` has a direct conversion, the
    function first tries this conversion, and uses `decode` only if the conversion fails.
    """

    def receive(data: bytes) -> None:
        if len(data) > wire.largest:
            errors.reject(f"the message has {len(data):,} bytes; its region holds at most {wire.largest:,}")
            return
        try:
            message = (wire.direct and wire.direct.decode(data, is_ros1)) or decode(data)
        except ValueError as error:
            errors.reject(str(error))
            return
        take(message)

    return receive


def sample_sender(
    wire: Wire, now: Callable[[], Time], send: Callable[[bytes], None], is_ros1: bool = False
) -> Callable[[Message], bool]:
    """Return a function that converts a sample to a serialized ROS message, and passes this to `send`.

    The function returns False if the topic has no direct conversion or a field of the sample is invalid. `now` returns
    the ROS time, for an unset time stamp.
    """

    def send_sample(sample: Message) -> bool:
        if wire.direct is None:
            return False
        try:
            data = wire.direct.encode(bytes(sample), now, is_ros1)
        except ValueRejected:
            return False
        send(data)
        return True

    return send_sample


def guarded(function: Callable[..., None], name: str, log: Callable[[str], None], *passes: type[Exception]) -> Any:
    """Return `function` wrapped to log its exceptions, except the types in `passes`. Log lines begin with `name`."""
    faults = Counters(name, log)

    def run(*arguments: Any) -> None:
        try:
            function(*arguments)
        except passes:
            raise
        except Exception as error:
            faults.log_rate_limited(describe(error))

    return run


def remember_bounded(values: dict[T, V], peer: T, value: V) -> None:
    """Set `values[peer]` to `value`. If `values` then has more than 1000 peers, remove the oldest one."""
    values[peer] = value
    if len(values) > _MOST_PEERS:
        del values[next(iter(values))]


def await_server(is_connected: Callable[[], bool], timeout: float) -> float:
    """Wait for a server. Return the deadline of the call, a time.monotonic() value. Raises NoAnswer at the deadline."""
    deadline = time.monotonic() + timeout
    while not is_connected():
        if time.monotonic() >= deadline:
            raise NoAnswer(f"no server within {timeout:g} s")
        time.sleep(_POLL_INTERVAL)
    return deadline


def await_answer(answer: Future[T], timeout: float, deadline: float, end_reason: Callable[[], str] = lambda: "") -> T:
    """Wait for the answer to a call. Raises NoAnswer at `deadline`, a value of time.monotonic().

    Also raises NoAnswer as soon as `end_reason()` returns a reason. `timeout` is only for the text of the error.
    """
    while True:
        with suppress(TimeoutError):
            return answer.result(max(0.0, min(_SERVER_POLL_INTERVAL, deadline - time.monotonic())))
        if why := end_reason():
            raise NoAnswer(why)
        if time.monotonic() >= deadline:
            raise NoAnswer(f"no answer within {timeout:g} s")


def join_all(threads: Iterable[threading.Thread]) -> bool:
    """Wait for the threads, up to SHUTDOWN_TIMEOUT in total. Return True if all have ended."""
    deadline, waiting = time.monotonic() + SHUTDOWN_TIMEOUT, list(threads)
    for thread in waiting:
        thread.join(max(0.0, deadline - time.monotonic()))
    return not any(thread.is_alive() for thread in waiting)
