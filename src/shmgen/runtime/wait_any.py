"""Turns many subscribers into one wait: a thread sleeps until the writer of any of them wakes it."""

from __future__ import annotations

import time
from collections.abc import Iterable
from typing import Any, TypeVar

from shmgen.core import abi
from shmgen.runtime import core
from shmgen.runtime.region.header import COMPLETED
from shmgen.runtime.subscriber import Subscriber

S = TypeVar("S", bound=Subscriber[Any])

_POLL = abi.POLL_MS / 1000
"""Seconds between two looks at a topic whose writer will not wake us."""
_SLICE = abi.WAKE_MS / 1000
"""Seconds of the longest single sleep: what a lost wake-up costs at most."""


def can_wait_for_many() -> bool:
    """Whether ready_any() of several sleeps until it is woken: in 64-bit processes with the extension in C, glibc and
    futex_waitv(2) (Linux 5.16, and nothing that forbids it). Elsewhere it looks every millisecond.
    """
    return core.HAS_MANY


def ready_any(subscribers: Iterable[S], timeout: float) -> list[S]:
    """Those with an unread sample, as soon as one has one, or none after `timeout` seconds; reads nothing.

    For one thread, as a subscriber is. What Subscriber.wait() says of several readers of a topic holds here too; beyond
    128 topics, which is the kernel's limit, it looks at all every millisecond. Raises what Subscriber.ready() does.
    """
    several = tuple(subscribers)
    if len(several) == 1:
        return list(several) if several[0].ready(timeout) else []
    deadline = time.monotonic() + timeout
    for one in several:
        if one._event is None:
            one._listen()
    while not (found := [one for one in several if one._words[COMPLETED] not in (0, one._last)]):
        left = deadline - time.monotonic()
        if left <= 0:
            break
        if not Subscriber._doze_all(several, int(min(left, _SLICE) * 1e9), int(_POLL * 1e9)):
            time.sleep(min(left, _POLL))
    return found
