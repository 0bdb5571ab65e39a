"""The protocol in plain Python, for machines without the extension in C.

The code is written to be read together with docs/protocol.md.
"""

from __future__ import annotations

import time

from shmgen.core import abi
from shmgen.runtime.reference.notifier import Notifier
from shmgen.runtime.reference.reader import Reader
from shmgen.runtime.reference.writer import Writer

__all__ = ["Notifier", "Reader", "Writer", "can_wait_for_many", "sleep_any"]


def can_wait_for_many() -> bool:
    """Return False: a sleep on many semaphores needs Linux's futex_waitv(2), which Python does not provide."""
    return False


def sleep_any(readers: tuple[Reader, ...], ns: int) -> None:
    """Sleep for 1 ms, or for `ns` nanoseconds if that is shorter. The caller then checks `readers` for new samples."""
    time.sleep(min(ns / 1e9, abi.POLL_MS / 1000))
