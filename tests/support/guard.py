"""End a test that would never end, by its CPU time."""

from __future__ import annotations

import signal
from collections.abc import Iterator
from contextlib import contextmanager
from types import FrameType


class TooLong(Exception):
    """The CPU time limit of within() was exceeded."""


@contextmanager
def within(seconds: float) -> Iterator[None]:
    """Raise TooLong after `seconds` of CPU time, which do not depend on the load of the machine.

    Raise it again each second, in case the cleanup hangs too.
    """

    def stop(number: int, frame: FrameType | None) -> None:
        raise TooLong(f"{seconds} s of CPU were not enough")

    before = signal.signal(signal.SIGPROF, stop)
    signal.setitimer(signal.ITIMER_PROF, seconds, 1)
    try:
        yield
    finally:
        signal.setitimer(signal.ITIMER_PROF, 0)
        signal.signal(signal.SIGPROF, before)
