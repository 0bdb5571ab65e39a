"""Waits for many subscribers at once, and opens many ends side by side."""

from __future__ import annotations

import time
from collections.abc import Iterable
from typing import Any, TypeVar

from shmgen.core import abi
from shmgen.runtime import engine
from shmgen.runtime.publisher import Publisher
from shmgen.runtime.region.header import RETIRED
from shmgen.runtime.region.resource import finish
from shmgen.runtime.subscriber import Subscriber

E = TypeVar("E", bound="Publisher[Any] | Subscriber[Any]")
S = TypeVar("S", bound=Subscriber[Any])

_SLICE = abi.WAKE_MS / 1000
"""Seconds of the longest single sleep: what a lost wake-up costs at most."""


def open_all(wanted: Iterable[tuple[type[E], str]], **options: Any) -> list[E]:
    """Opens (class, topic) side by side, in the time of the slowest; `options` are those of each class.

    Raises what the first raises that cannot be opened; then all are closed.
    """
    begun: list[tuple[E, Any]] = []
    try:
        for kind, topic in wanted:
            side = kind.__new__(kind)
            begun.append((side, side._begin(topic, **options)))
        finish([end for _, end in begun])
    except BaseException:
        for _, end in begun:
            end.close()
        raise
    for side, end in begun:
        side._end = end
    return [side for side, _ in begun]


def can_wait_for_many() -> bool:
    """Whether ready_any() of several sleeps until it is woken: in 64-bit processes with the extension in C, glibc and
    futex_waitv(2) (Linux 5.16, and nothing that forbids it). Elsewhere it looks every millisecond.
    """
    return bool(engine.can_wait_for_many())


def ready_any(subscribers: Iterable[S], timeout: float) -> list[S]:
    """Those with an unread sample, as soon as one has one, or none after `timeout` seconds; reads nothing. One whose
    region was removed or replaced is among them: reading it says so.

    For one thread, as a subscriber is. Beyond the kernel's limit, 64 topics of a PLC or 128 of other programs, it looks
    at all every millisecond. Raises what Subscriber.ready() does.
    """
    several = tuple(subscribers)
    if len(several) == 1:
        return list(several) if several[0].ready(timeout) else []
    deadline = time.monotonic() + timeout
    ends = tuple(one._end for one in several)
    while not (found := [one for one in several if _has_news(one._end)]):
        left = deadline - time.monotonic()
        if left <= 0:
            break
        engine.sleep_any(ends, int(min(left, _SLICE) * 1e9))
    return found


def _has_news(end: Any) -> bool:
    return end.newest() not in (0, end.last) or bool(end.load(RETIRED))
