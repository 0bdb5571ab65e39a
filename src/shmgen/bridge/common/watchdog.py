"""Ends the process if it hangs, even if a library blocks with the GIL held."""

from __future__ import annotations

import faulthandler
import os
import signal
import sys
from typing import TYPE_CHECKING, Any, NoReturn

if TYPE_CHECKING:
    ALARM: Any
else:
    try:
        if os.environ.get("SHMGEN_PURE") or "t" in getattr(sys, "abiflags", ""):
            raise ImportError
        from shmgen import _alarm as ALARM
    except ImportError:  # installed without a compiler: only `reset` guards the process
        ALARM = None

STALL_LIMIT = 10.0
"""Seconds without a heartbeat after which the process prints all stacks and exits with status 1."""
STOP_LIMIT = 2
"""Seconds that the process may take after SIGINT or SIGTERM, and for each step of an orderly shutdown."""
_STDERR = 2


def reset(seconds: float = STALL_LIMIT) -> None:
    """Restart the watchdog. After `seconds`, it prints all stacks and exits with status 1, even if the GIL is held."""
    faulthandler.dump_traceback_later(seconds, exit=True, file=_STDERR)


def cancel() -> None:
    """Stop the watchdog."""
    faulthandler.cancel_dump_traceback_later()


def limit_signals(numbers: tuple[signal.Signals, ...]) -> None:
    """Let SIGALRM print all stacks and end the process 2 s after one of these signals. See signals_handled()."""
    if ALARM is not None:
        faulthandler.register(signal.SIGALRM, file=_STDERR, all_threads=True, chain=True)
        for number in numbers:
            ALARM.start_at(number, STOP_LIMIT)


def signals_handled() -> None:
    """Cancel the time limit of `limit_signals`. From now on, each shutdown step sets its own limit."""
    signal.alarm(0)


def exit_at_once(status: int = 0) -> NoReturn:
    """End the process without Python's cleanup. In this cleanup, a ROS library may block for ever, or crash."""
    sys.stdout.flush()
    sys.stderr.flush()
    os._exit(status)
