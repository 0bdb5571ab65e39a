"""Writes samples into a region (docs/protocol.md, "Writing")."""

from __future__ import annotations

import time
from collections.abc import Generator
from typing import Any

from shmgen.core import abi
from shmgen.runtime.messages.message import CUT, Late
from shmgen.runtime.reference.bell import ring
from shmgen.runtime.reference.claim import claim
from shmgen.runtime.reference.end import End
from shmgen.runtime.reference.lock import LOCK_TIMEOUT, Lock
from shmgen.runtime.reference.memory_order import fence, keeps_order
from shmgen.runtime.reference.opening import open_region
from shmgen.runtime.refusals import claim_lost, lock_timeout
from shmgen.runtime.region import header as h
from shmgen.runtime.region.looks import writer_of
from shmgen.runtime.region.settings import UNTIL_RECOVERED


class Writer(End):
    """The one writer of a topic. `sequence` is the number of its newest sample."""

    sequence = 0
    doubtful = False
    truncations = 0

    def _open(self) -> Generator[int, None, None]:
        of = self.of
        self.region = region = yield from open_region(of, writes=True)
        usual = LOCK_TIMEOUT if keeps_order() or of.sequence else UNTIL_RECOVERED
        self.lock = Lock(region, usual if of.lock_ns < 0 else of.lock_ns / 1e9)
        self.sequence, self._turn, self.doubtful = yield from claim(of.topic, region)
        self._heartbeat = region.words[h.HEARTBEAT]
        self.gone = None

    def publish(self, message: Any, left: int | None = None) -> None:
        """Writes a message: one of its kind, or any object with its attributes. `left`: ns of a call that ends then.

        Raises ValueRejected, LockTimeout, ClaimLost.
        """
        data, late = self._encoded(message)
        self._one_call(self._publish, data, late, None if left is None else left / 1e9)

    def heartbeat(self) -> None:
        """Shows readers that the writer is alive, without a sample. Raises ClaimLost, RegionRetired."""
        self.is_removed()
        self.assure()
        self._beat()

    def assure(self) -> None:
        """Raises ClaimLost unless the topic is still this writer's, RegionRetired unless its region is the topic's."""
        self._need_region()
        if self.load(h.WRITER) != self.region.pid or self.load(h.TURN) != self._turn:
            self._lose()

    def _encoded(self, message: Any) -> tuple[bytes | bytearray, Late]:
        """Its bytes, and those of arrays that lie in place of some."""
        if type(message) is self.of.kind:
            return bytes(message), []
        data, late = bytearray(self.of.size), []  # type: ignore[var-annotated]
        self.of.kind._encode(message, data, 0, late)
        arrays = [found for found in late if found is not CUT]
        self.truncations += len(late) - len(arrays)
        return data, arrays

    def _publish(self, data: bytes | bytearray, late: Late, left: float | None) -> None:
        try:
            self._write(data, late, left)
        finally:
            self.lock.release()
        fence()  # keeps the look at `armed` behind `completed`
        words = self.region.words
        if words[h.ARMED]:
            words[h.ARMED] = 0
            words[h.BELL] = self.sequence
            ring(self.region.map)

    def _write(self, data: bytes | bytearray, late: Late, left: float | None) -> None:
        region, words = self.region, self.region.words
        if not self.lock.acquire(left) and not self.lock.keeps_order:
            raise lock_timeout(self.of.topic, words[h.LOCK_HOLDER])
        self.assure()
        number, lane = h.after(self.sequence, 1, region.header.slots), h.lane(self._turn)
        slot = region.slot(number, lane)
        payload = region.payload(slot)
        self._beat()
        words[slot // 4 + 2 * h.NUMBER] = 0
        # memcpy may use streaming stores, which pass earlier ones even on x86.
        fence()
        region.quads[slot // 8 + h.STAMP] = time.time_ns()
        region.map[payload] = data
        for offset, _, array in late:
            region.map[payload.start + offset : payload.start + offset + array.nbytes] = array
        self.assure()
        self.sequence = number  # first: who comes upon this with an exception must not let it be used again
        words[slot // 4 + 2 * h.NUMBER] = number
        words[h.COMPLETED0 + lane] = number
        if number % abi.FORGET == 0:
            words[h.COMPLETED1 - lane] = words[h.LEFT] = 0

    def _beat(self) -> None:
        self._heartbeat = self._heartbeat + 1 & h.LAST
        self.region.words[h.HEARTBEAT] = self._heartbeat

    def _lose(self) -> None:
        """Leaves the topic to the writer who has claimed it: this one stood still for a second, or seemed to."""
        who = writer_of(self.of.topic, self.region.file, self.region.words[h.WRITER])
        lost = claim_lost(self.of.topic, who)
        self._let_go(lost)
        raise lost
