"""Ends what would go on for ever, by the seconds of CPU that it takes."""

from __future__ import annotations

import signal
from collections.abc import Iterator
from contextlib import contextmanager
from types import FrameType


class TooLong(Exception):
    """It would have gone on."""


@contextmanager
def within(seconds: float) -> Iterator[None]:
    """A guard against hanging, no measurement: seconds of CPU, of which a busy machine takes no more.

    Raises TooLong there, and each second after, where what tidies up hangs as well.
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
