"""Turns a publisher, a subscriber or a topic into the region behind it, as another process has it: words to look at and
to change, its lock, its record locks."""

from __future__ import annotations

import io
import mmap
import os
from typing import Any

from shmgen.core import abi
from shmgen.runtime.reference.region import Region, Semaphore
from shmgen.runtime.region import header as h
from shmgen.runtime.region.looks import peek
from shmgen.runtime.region.names import region_file, region_name, semaphore_file


class File(io.FileIO):
    """Closed when nobody has it any more."""

    def __del__(self) -> None:
        self.close()


class Opened(Region):
    """Lasts as long as somebody has it, or its words."""

    name: str

    def sample(self, number: int) -> slice:
        """Where sample `number` of the present writer lies, the header of its slot first."""
        slot = self.slot(number, self.words[h.TURN] % abi.LANES)
        return slice(slot, self.payload(slot).stop)

    def number_at(self, number: int) -> int:
        """Which word its slot's number is."""
        return self.sample(number).start // 4 + 2 * h.NUMBER


def region_of(side: Any) -> Opened:
    topic = side if isinstance(side, str) else side.topic
    name = region_name(topic)
    file = File(os.open(region_file(name), os.O_RDWR | os.O_CLOEXEC), "r+b")
    header = peek(file.fileno())
    locked = os.path.exists(semaphore_file(name))
    made = Opened(
        file, mmap.mmap(file.fileno(), header.size), header, Semaphore("/" + name) if locked else Semaphore("")
    )
    made.name = name
    return made
