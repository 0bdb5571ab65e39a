"""The protocol in Python, without a trick: for machines without the extension, and to read beside docs/protocol.md."""

from __future__ import annotations

import time

from shmgen.core import abi
from shmgen.runtime.reference.reader import Reader
from shmgen.runtime.reference.writer import Writer

__all__ = ["Reader", "Writer", "can_wait_for_many", "sleep_any"]


def can_wait_for_many() -> bool:
    """One sleep on many semaphores is Linux's futex_waitv, which Python does not have."""
    return False


def sleep_any(readers: tuple[Reader, ...], ns: int) -> None:
    """Until one of them may have something, at most so long."""
    time.sleep(min(ns / 1e9, abi.POLL_MS / 1000))
