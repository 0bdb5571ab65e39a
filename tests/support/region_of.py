"""Open the region of a publisher, a subscriber or a topic as another process would: its 32-bit numbers,
its lock and its record locks."""

from __future__ import annotations

import io
import mmap
import os
from typing import Any

from shmgen.core import abi
from shmgen.runtime.reference.region import Region, Semaphore
from shmgen.runtime.region import header as h
from shmgen.runtime.region.checks import read_header_of
from shmgen.runtime.region.names import region_file, region_name, semaphore_file


class File(io.FileIO):
    """A file that is closed when it is no longer referenced."""

    def __del__(self) -> None:
        self.close()


class Opened(Region):
    """A region that stays mapped while it or its `words` are referenced."""

    name: str

    def sample(self, number: int) -> slice:
        """Return the bytes of sample `number` of the current writer, including the slot's header."""
        slot = self.slot(number, self.words[h.TURN] % abi.LANES)
        return slice(slot, self.payload(slot).stop)

    def number_at(self, number: int) -> int:
        """Return the index in `words` of the sample number in the slot's header."""
        return self.sample(number).start // 4 + 2 * h.NUMBER


def region_of(side: Any) -> Opened:
    topic = side if isinstance(side, str) else side.topic
    name = region_name(topic)
    file = File(os.open(region_file(name), os.O_RDWR | os.O_CLOEXEC), "r+b")
    header = read_header_of(file.fileno())
    locked = os.path.exists(semaphore_file(name))
    region = Opened(
        file, mmap.mmap(file.fileno(), header.size), header, Semaphore("/" + name) if locked else Semaphore("")
    )
    region.name = name
    return region
