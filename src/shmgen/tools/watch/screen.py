"""Shows the table of `shmgen top` on a live screen, with updates and keys."""

from __future__ import annotations

import os
import select
import shutil
import signal
import sys
import termios
import time
import tty
from collections.abc import Iterator
from contextlib import contextmanager
from types import FrameType

from shmgen.core.plural import counted
from shmgen.live.regions import unlisted
from shmgen.tools.watch import overview

_ENTER = "\x1b[?1049h\x1b[?25l"
"""Escape codes that switch to the alternate screen and hide the cursor. _LEAVE restores the previous content."""
_LEAVE = "\x1b[?25h\x1b[?1049l"
_HOME = "\x1b[H"
_TO_END_OF_LINE = "\x1b[K"
_TO_END_OF_SCREEN = "\x1b[J"
_REVERSE, _NORMAL = "\x1b[7m", "\x1b[m"
_KEYS = "q quit   s sort by next column   r reverse"


def run(interval: float) -> None:
    """Show a table of all regions, with an update every `interval` seconds, until the user presses `q`."""
    past: overview.Past = {}
    widths: dict[str, int] = {}
    column, reverse = 0, False
    with _screen():
        rows = overview.look(past)
        while True:
            _draw(overview.ordered(rows, overview.COLUMNS[column], reverse), overview.COLUMNS[column], widths)
            due = time.monotonic() + interval
            while (left := due - time.monotonic()) > 0:
                for key in _keys(left):
                    match key:
                        case "q" | "\x04":
                            return
                        case "s":
                            column = (column + 1) % len(overview.COLUMNS)
                        case "r":
                            reverse = not reverse
                _draw(overview.ordered(rows, overview.COLUMNS[column], reverse), overview.COLUMNS[column], widths)
            rows = overview.look(past)


def _draw(rows: list[overview.Row], column: str, widths: dict[str, int]) -> None:
    width, height = shutil.get_terminal_size()
    title, *lines = overview.table(rows, column, width, widths)
    wider = [name.upper() for name in overview.COLUMNS if name.upper() not in title]
    notes = [*filter(None, [unlisted(rows)]), *([f"a wider terminal shows {', '.join(wider)}"] if wider else [])]
    head = f"shmgen top   {time.strftime('%H:%M:%S')}   {counted(len(rows), 'region')}   {_KEYS}"
    room = height - 3 - len(notes)
    if len(lines) > room:
        notes.insert(0, f"... {len(lines) - room + 1} more")
    screen_lines = [head[:width], "", _REVERSE + title[:width].ljust(width) + _NORMAL]
    screen_lines += [line[:width] for line in [*lines[: height - 3 - len(notes)], *notes]]
    sys.stdout.write(_HOME + "\r\n".join(line + _TO_END_OF_LINE for line in screen_lines) + _TO_END_OF_SCREEN)
    sys.stdout.flush()


def _keys(timeout: float) -> str:
    """Return the keys pressed within `timeout` seconds, or Ctrl-D if the input ended. Ignore arrow keys."""
    if select.select([sys.stdin], [], [], timeout)[0]:
        pressed = os.read(sys.stdin.fileno(), 64).decode(errors="replace") or "\x04"
        return "" if pressed.startswith("\x1b") else pressed
    return ""


@contextmanager
def _screen() -> Iterator[None]:
    """Set the terminal to read single keys, and restore the previous state at the end.

    SIGTERM and the end of an ssh session restore the terminal too.
    """

    def leave(number: int, frame: FrameType | None) -> None:
        sys.exit(128 + number)

    before = termios.tcgetattr(sys.stdin)
    handlers = {number: signal.signal(number, leave) for number in (signal.SIGTERM, signal.SIGHUP)}
    tty.setcbreak(sys.stdin)
    sys.stdout.write(_ENTER)
    try:
        yield
    finally:
        for number, handler in handlers.items():
            signal.signal(number, handler)
        sys.stdout.write(_LEAVE)
        sys.stdout.flush()
        termios.tcsetattr(sys.stdin, termios.TCSADRAIN, before)
