"""Writes samples into a region (docs/protocol.md, "Write")."""

from __future__ import annotations

import ctypes
import mmap
import os
import sys
import time
from collections.abc import Generator
from typing import Any

from shmgen.core import abi
from shmgen.runtime.messages.steps import has_table
from shmgen.runtime.messages.walker import encode
from shmgen.runtime.reference.claim import claim
from shmgen.runtime.reference.end import End, NotOpenYet
from shmgen.runtime.reference.lock import LOCK_TIMEOUT, Lock
from shmgen.runtime.reference.memory_order import fence, keeps_order
from shmgen.runtime.reference.opening import open_region
from shmgen.runtime.refusals import claim_lost, lock_timeout
from shmgen.runtime.region import header as h
from shmgen.runtime.region.record_locks import describe_writer
from shmgen.runtime.region.settings import UNTIL_RECOVERED

_POLL = abi.POLL_MS / 1000
"""Seconds between two steps of reopening a removed region."""
_FUTEX = {"x86_64": 202, "aarch64": 98, "riscv64": 98}.get(os.uname().machine) if sys.maxsize > 2**32 else 240
"""The system call number of futex(2) (asm/unistd.h), or None if unknown here: then sleepers wake by their timeout."""
_WAKE = 1
_ALL = 2**31 - 1


class Writer(End):
    """The writer of a topic: publishes samples in the topic's region. `sequence` is the number of its newest sample."""

    sequence = 0
    predecessor_may_be_alive = False
    truncations = 0
    _scratch: bytearray | None = None

    def _open(self) -> Generator[int, None, None]:
        of = self.of
        self.region = region = yield from open_region(of, writes=True)
        usual = LOCK_TIMEOUT if keeps_order() or of.sequence else UNTIL_RECOVERED
        self.lock = Lock(region, usual if of.lock_ns < 0 else of.lock_ns / 1e9)
        self.sequence, self._turn, self.predecessor_may_be_alive = yield from claim(of.topic, region)
        self._heartbeat = region.words[h.HEARTBEAT]
        self.closed_error = None

    def publish(self, message: Any, left: int | None = None) -> None:
        """Write `message`, an object of the topic's message class or any object with the same attributes.

        `left` is the remaining time in ns of the caller's timeout. Raises ValueRejected, LockTimeout and ClaimLost.
        """
        within = None if left is None else left / 1e9
        if type(message) is self.of.kind:
            self._await_written(bytes(message), within)
            return
        if not has_table(self.of.kind):
            raise TypeError(f"{self.of.kind!r} has no table of fields: publish an object of it")
        data, self._scratch = self._scratch, None  # a nested call allocates its own buffer
        if data is None:
            data, self._zeros = bytearray(self.of.size), bytearray(self.of.size)
        try:
            data[:] = self._zeros
            truncated = encode(self.of.kind, message, data)
            self._await_written(data, within)
            self.truncations += truncated
        finally:
            self._scratch = data

    def _await_written(self, data: bytes | bytearray, left: float | None) -> None:
        """Publish `data`. While a removed region is being reopened, wait."""
        while True:
            try:
                self._call_alone(self._publish, data, left)
                return
            except NotOpenYet:
                time.sleep(_POLL)

    def heartbeat(self) -> None:
        """Show readers that the writer is alive, without publishing a sample.

        Raises ClaimLost if another writer has the topic. Raises RegionRetired if the region was removed.
        """
        self._inspect(self._show_life, None)

    def check_claim(self) -> None:
        """Raise ClaimLost if another writer has claimed the topic, or RegionRetired if the region was removed."""
        self._inspect(self._check_claim, None)

    def _show_life(self) -> None:
        self._check_claim()
        self._beat()

    def _check_claim(self) -> None:
        self._need_region()
        words = self.region.words
        if words[h.WRITER] != self.region.pid or words[h.TURN] != self._turn:
            self._lose()

    def _publish(self, data: bytes | bytearray, left: float | None) -> None:
        try:
            self._write(data, left)
        finally:
            self.lock.release()
        fence()  # a full barrier between the store of `completed` and the load of `armed`
        words = self.region.words
        if words[h.ARMED]:
            words[h.ARMED] = 0
            words[h.BELL] = self.sequence
            ring(self.region.map)

    def _write(self, data: bytes | bytearray, left: float | None) -> None:
        region, words = self.region, self.region.words
        if not self.lock.acquire(left) and not self.lock.keeps_order:
            raise lock_timeout(self.of.topic, words[h.LOCK_HOLDER])
        self._check_claim()
        number, lane = h.after(self.sequence, 1, region.header.slots), h.lane(self._turn)
        slot = region.slot(number, lane)
        payload = region.payload(slot)
        self._beat()
        words[slot // 4 + 2 * h.NUMBER] = 0
        # memcpy may use streaming stores, which can pass earlier stores even on x86.
        fence()
        region.quads[slot // 8 + h.STAMP] = time.time_ns()
        region.map[payload] = data
        self._check_claim()
        self.sequence = number  # stored first, so that an interrupting exception cannot cause a reuse of the number
        words[slot // 4 + 2 * h.NUMBER] = number
        words[h.COMPLETED0 + lane] = number
        if number % abi.FORGET == 0:
            words[h.COMPLETED1 - lane] = words[h.LEFT] = 0

    def _beat(self) -> None:
        self._heartbeat = self._heartbeat + 1 & h.LAST
        self.region.words[h.HEARTBEAT] = self._heartbeat

    def _lose(self) -> None:
        """Close this writer and raise ClaimLost, because another writer has claimed the topic.

        Another writer may claim the topic after 1 s without a heartbeat of this writer.
        """
        who = describe_writer(self.region.file, self.region.words[h.WRITER])
        lost = claim_lost(self.of.topic, who)
        self._release(lost)
        raise lost


def ring(map: mmap.mmap) -> None:
    """Wake all readers that wait for a new sample of the mapped region. Such readers sleep on the field `bell`."""
    if _FUTEX is not None:
        word = ctypes.c_uint32.from_buffer(map, 4 * h.BELL)
        ctypes.CDLL(None).syscall(ctypes.c_long(_FUTEX), ctypes.byref(word), _WAKE, _ALL, None, None, 0)
