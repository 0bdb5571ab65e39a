"""Counts the messages that Cyclone drops, and forwards Cyclone's other log lines to the bridge's log.

Cyclone's Python binding offers no status, statistic or log callback for dropped messages: Cyclone only writes log lines
to C's `stderr`. A domain always writes to the file that was `stderr` when the domain was created. Therefore this module
sets `stderr` to a pipe during the creation, and reads the pipe. Forwarded lines get a prefix, because the text may come
from a peer.
"""

from __future__ import annotations

import ctypes
import os
import re
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager

from shmgen.bridge.common.support import guarded

_LARGE = re.compile(r"dropping oversize \((\d+) > (\d+)\) sample \d+ from remote writer [\da-f:]+ (\S+)/[^/\s]+$")
_OTHER = re.compile(r"data\(application, .* #\d+: deserialization (\S+)/[^/\s]+ failed \((.*)\)$")
_BEFORE = re.compile(r"^\d+\.\d+ \[\d+\] +\S+: ")
"""Prefix of Cyclone's log lines: time, domain and thread."""
_READ_TIMEOUT = 1.0
"""Maximum seconds to wait until pending log lines are read."""


class Dropped:
    """Reads the log lines of a Cyclone domain. Create the domain inside `with listens()`.

    `calls` maps a DDS topic such as `rt/pose` to two callbacks. The first is called for each message that is too large,
    the second for each message that Cyclone cannot decode. Both run in a thread that reads until the process ends.
    """

    def __init__(self, log: Callable[[str], None]) -> None:
        self.calls: dict[str, tuple[Callable[[str], None], Callable[[str], None]]] = {}
        self._log = log
        self._is_read = threading.Event()

    @contextmanager
    def listens(self) -> Iterator[None]:
        """Replace C's `stderr` with a pipe inside the `with` block, which creates a Cyclone domain.

        This works with glibc only, where `stderr` is a variable. With another C library, Cyclone's log lines go to
        stderr and are not counted. If creating the domain fails, its log lines are reported before the exception.
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
            self._is_read.wait(_READ_TIMEOUT)
            raise
        finally:
            stderr.value = before

    def _run(self, source: int) -> None:
        take = guarded(self._take, "dds", self._log)  # if a callback fails, the other topics still need this thread
        with open(source, encoding="utf-8", errors="replace") as lines:
            for line in map(str.rstrip, lines):
                take(line)

    def _take(self, line: str) -> None:
        if not line:
            self._is_read.set()
        elif (match := _LARGE.search(line)) and (calls := self.calls.get(match[3])):
            calls[0](f"the message has {int(match[1]):,} bytes; the bridge receives at most {int(match[2]):,}")
        elif (match := _OTHER.search(line)) and (calls := self.calls.get(match[1])):
            calls[1](f"its bytes do not have the bridge's type ({match[2]})")
        else:
            self._log(f"dds: Cyclone: {_BEFORE.sub('', line)}")
