"""Counts what Cyclone complains that it dropped, and passes its other complaints to the bridge's log.

Cyclone has no status, statistic or log sink for it in Python: it writes to the stderr of C that was in force when its
domain was made, which is a pipe here, so that no word of a peer begins a line of the log.
"""

from __future__ import annotations

import ctypes
import os
import re
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager

_LARGE = re.compile(r"dropping oversize \((\d+) > (\d+)\) sample \d+ from remote writer [\da-f:]+ (\S+)/[^/\s]+$")
_OTHER = re.compile(r"data\(application, .* #\d+: deserialization (\S+)/[^/\s]+ failed \((.*)\)$")
_BEFORE = re.compile(r"^\d+\.\d+ \[\d+\] +\S+: ")
"""Cyclone's clock, domain and thread."""
_A_MOMENT = 1.0
"""Seconds, at most, for what was said to be read."""


class Dropped:
    """What the domain of this process says that is made while `listens`, as long as the process lasts.

    `calls` has for a topic, `rt/pose`, what is called for each message that is too large, and for each that is no
    message of its type, in a thread that is none of the topic's.
    """

    def __init__(self, log: Callable[[str], None]) -> None:
        self.calls: dict[str, tuple[Callable[[str], None], Callable[[str], None]]] = {}
        self._log = log
        self._told = threading.Event()

    @contextmanager
    def listens(self) -> Iterator[None]:
        """Only where stderr is a variable, which glibc says: elsewhere Cyclone's lines stay on stderr, uncounted.

        What it said of an exception is told before that leaves.
        """
        if "CS_GNU_LIBC_VERSION" not in os.confstr_names:
            yield
            return
        source, sink = os.pipe2(os.O_CLOEXEC)
        threading.Thread(target=self._run, args=(source,), name="dropped", daemon=True).start()
        libc = ctypes.CDLL(None)
        libc.fdopen.restype = ctypes.c_void_p
        stream = libc.fdopen(sink, b"w")
        libc.setlinebuf(ctypes.c_void_p(stream))
        stderr = ctypes.c_void_p.in_dll(libc, "stderr")
        before, stderr.value = stderr.value, stream
        try:
            yield
        except Exception:
            os.write(sink, b"\n")
            self._told.wait(_A_MOMENT)
            raise
        finally:
            stderr.value = before

    def forget(self, topic: str) -> None:
        """Nothing is called any more."""
        self.calls.pop(topic, None)

    def _run(self, source: int) -> None:
        with open(source, encoding="utf-8", errors="replace") as lines:
            for line in map(str.rstrip, lines):
                if not line:
                    self._told.set()
                elif (found := _LARGE.search(line)) and (calls := self.calls.get(found[3])):
                    calls[0](f"{int(found[1]):,} bytes, and more than {int(found[2]):,} are not received")
                elif (found := _OTHER.search(line)) and (calls := self.calls.get(found[1])):
                    calls[1](f"its bytes are no message of our type ({found[2]})")
                else:
                    self._log(f"dds: Cyclone says: {_BEFORE.sub('', line)}")
