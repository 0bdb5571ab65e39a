"""Turns what Cyclone warns of messages it does not receive, being too large, into calls of those who count them.

Cyclone has no status, statistic or log sink for it in Python: it writes a line to stderr, and to its trace, which is
a pipe here. Where CYCLONEDDS_URI has a trace of its own, nothing comes.
"""

from __future__ import annotations

import os
import re
import threading
from collections.abc import Callable

_LINE = re.compile(r"dropping oversize \((\d+) > (\d+)\) sample \d+ from remote writer [\da-f:]+ (\S+)/[^/\s]+$")


class Dropped:
    """The trace of one domain of this process, as long as the process lasts."""

    def __init__(self) -> None:
        source, self._sink = os.pipe2(os.O_CLOEXEC)
        self._calls: dict[str, Callable[[str], None]] = {}
        threading.Thread(target=self._run, args=(source,), name="dropped", daemon=True).start()

    @property
    def config(self) -> str:
        """The part of Cyclone's configuration that asks for it; the path is opened once, at the first participant."""
        trace = f"<Tracing><Category>warning</Category><OutputFile>/proc/self/fd/{self._sink}</OutputFile></Tracing>"
        return f'<CycloneDDS><Domain Id="any">{trace}</Domain></CycloneDDS>'

    def tell(self, topic: str, call: Callable[[str], None]) -> None:
        """From now on `call` hears of each message of a topic, `rt/pose`, in a thread that is none of the topic's."""
        self._calls[topic] = call

    def _run(self, source: int) -> None:
        with open(source, encoding="utf-8", errors="replace") as lines:
            for line in lines:
                found = _LINE.search(line.rstrip("\n"))
                if found and (call := self._calls.get(found[3])):
                    call(f"{int(found[1]):,} bytes, and more than {int(found[2]):,} are not received")
