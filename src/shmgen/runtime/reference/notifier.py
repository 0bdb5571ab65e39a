"""Notifies event loops of new samples: a thread polls several readers and makes a file descriptor readable."""

from __future__ import annotations

import os
import threading
import time
from contextlib import suppress

from shmgen.core import abi
from shmgen.runtime.errors import ShmError
from shmgen.runtime.reference.reader import Reader
from shmgen.runtime.region import header as h

_POLL = abi.POLL_MS / 1000
"""Seconds between two polls of all readers."""
_REMOVAL_CHECK = abi.REMOVED_MS / 1000
"""Approximate seconds between two reports of a reader whose region was removed."""


class Notifier:
    """Report the watched readers that have a new sample. Report each sample once."""

    def __init__(self) -> None:
        self._file = os.eventfd(0, os.EFD_CLOEXEC | os.EFD_NONBLOCK)
        self._reported: dict[Reader, int] = {}
        self._news: list[Reader] = []
        self._lock = threading.Lock()
        self._has_readers = threading.Event()
        self._thread = threading.Thread(target=self._run, daemon=True)
        self._thread.start()

    def add(self, reader: Reader) -> bool:
        """Report samples of this reader from now on. Do nothing if the reader is already watched.

        Return True always. The engine in C returns False if the reader is not open.
        """
        reader.load(h.RETIRED)
        with self._lock:
            if self._file < 0:
                raise ValueError("this notifier is closed")
            self._reported.setdefault(reader, reader.last)
            self._has_readers.set()
        return True

    def remove(self, reader: Reader) -> None:
        """Stop reporting samples of this reader."""
        with self._lock:
            self._reported.pop(reader, None)
            self._news = [one for one in self._news if one is not reader]

    def ready(self) -> list[Reader]:
        """Return the readers with unreported samples, and make the descriptor unreadable again."""
        with self._lock:
            with suppress(BlockingIOError):
                if self._file >= 0:
                    os.eventfd_read(self._file)
            ready, self._news = self._news, []
        return ready

    def fileno(self) -> int:
        """Return the descriptor, or -1 if the notifier is closed."""
        return self._file

    def close(self) -> None:
        """Stop the thread and close the descriptor."""
        with self._lock:
            file, self._file = self._file, -1
            self._has_readers.set()
        if file >= 0:
            self._thread.join()
            os.close(file)

    def close_in_child(self) -> None:
        """Close the descriptor in a forked child, in which the thread does not exist."""
        self._lock = threading.Lock()
        file, self._file = self._file, -1
        if file >= 0:
            os.close(file)

    def _run(self) -> None:
        while self._file >= 0:
            self._has_readers.wait()
            with self._lock:
                ready = [reader for reader in tuple(self._reported) if self._has_news(reader)]
                self._news += [reader for reader in ready if reader not in self._news]
                if not self._reported and self._file >= 0:
                    self._has_readers.clear()
                if ready and self._file >= 0:
                    os.eventfd_write(self._file, 1)
            time.sleep(_POLL)

    def _has_news(self, reader: Reader) -> bool:
        try:
            reader.is_removed()
            newest, is_retired = reader.newest(), bool(reader.load(h.RETIRED))
        except (ShmError, AttributeError, ValueError):  # another thread is closing the reader
            del self._reported[reader]
            return True
        former = self._reported[reader]
        self._reported[reader] = newest
        if is_retired:  # the caller's next read reopens the region or raises RegionRetired
            self._reported[reader] = 0
            return time.monotonic() % _REMOVAL_CHECK < _POLL
        return newest not in (0, former)
