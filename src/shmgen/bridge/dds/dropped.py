"""Turns what Cyclone warns of messages it drops, too large or not of our type, into calls of those who count them.

Cyclone has no status, statistic or log sink for it in Python: it writes a line to stderr, and to its trace, which is
a pipe here. Where CYCLONEDDS_URI has a trace of its own, nothing comes.
"""

from __future__ import annotations

import os
import re
import threading
from collections.abc import Callable

_LARGE = re.compile(r"dropping oversize \((\d+) > (\d+)\) sample \d+ from remote writer [\da-f:]+ (\S+)/[^/\s]+$")
_OTHER = re.compile(r"data\(application, .* #\d+: deserialization (\S+)/[^/\s]+ failed \((.*)\)$")


class Dropped:
    """The trace of one domain of this process, as long as the process lasts."""

    def __init__(self) -> None:
        source, self._sink = os.pipe2(os.O_CLOEXEC)
        self._calls: dict[str, tuple[Callable[[str], None], Callable[[str], None]]] = {}
        threading.Thread(target=self._run, args=(source,), name="dropped", daemon=True).start()

    @property
    def config(self) -> str:
        """The part of Cyclone's configuration that asks for it; the path is opened once, at the first participant."""
        trace = f"<Tracing><Category>warning</Category><OutputFile>/proc/self/fd/{self._sink}</OutputFile></Tracing>"
        return f'<CycloneDDS><Domain Id="any">{trace}</Domain></CycloneDDS>'

    def tell(self, topic: str, large: Callable[[str], None], other: Callable[[str], None]) -> None:
        """From now on each message of a topic, `rt/pose`, is told, in a thread that is none of the topic's."""
        self._calls[topic] = large, other

    def forget(self, topic: str) -> None:
        """Nothing is told any more."""
        self._calls.pop(topic, None)

    def _run(self, source: int) -> None:
        with open(source, encoding="utf-8", errors="replace") as lines:
            for line in lines:
                if (found := _LARGE.search(line.rstrip("\n"))) and (calls := self._calls.get(found[3])):
                    calls[0](f"{int(found[1]):,} bytes, and more than {int(found[2]):,} are not received")
                elif (found := _OTHER.search(line.rstrip("\n"))) and (calls := self._calls.get(found[1])):
                    calls[1](f"its bytes are no message of our type ({found[2]})")
