"""Turns the straight way of publish and read into one call in C where there is the extension; without it into nothing.

`_straight` of a publisher or a subscriber does all from the lock to `completed`, or nothing at all: then the Python
beside it does, as it does without the extension and with SHMGEN_PURE in the environment (docs/python.md).
"""

from __future__ import annotations

import ctypes
import mmap
from typing import TYPE_CHECKING, Any, TypeAlias

from shmgen.runtime.messages.fields import Elements
from shmgen.runtime.messages.message import LATE_FROM, Late
from shmgen.runtime.messages.range_checks import CODES
from shmgen.runtime.region.header import SLOT_HEADER
from shmgen.runtime.region.memory_order import EXTENSION
from shmgen.runtime.region.region import Region
from shmgen.runtime.region.semaphores import NoSemaphore, Semaphore

MOST_OBJECTS = 32
"""The message and all that lie in it, that the extension takes numbers from."""

Plan: TypeAlias = "tuple[tuple[str, int, int, int, int, int], ...]"
"""Steps through a message: (attribute, struct's code or 0 for an object, offset in scratch, number of the object, most
elements or 0 for no array, offset of their count or 0 for one that is always full)."""


class _PureWriter:
    _sequence: int
    _heartbeat: int

    def _connect(self, *where: int | Plan | mmap.mmap | type | ctypes.Array[Any] | None) -> None:
        pass

    def _disconnect(self) -> None:
        pass

    def _straight(self) -> bool:
        """Publishes what lies in scratch; False: has done nothing."""
        return False

    def _with_late(self, late: Late) -> bool:
        """The same with arrays that were left out of scratch."""
        return False

    def _at_once(self, message: Any) -> bool:
        """Publishes one of the message type, or plain numbers alone out of any object; False: has done nothing."""
        return False


class _PureReader:
    _last: int
    _missed: int
    _stamp: int | None
    _event_at: int

    def _connect(self, *where: int | bool) -> None:
        pass

    def _disconnect(self) -> None:
        pass

    def _straight(self, number: int) -> bytes | bytearray | None:
        """The payload of sample `number`, which then counts as read; None: has done nothing."""
        return None

    def _doze(self, ns: int, newest: int) -> bool:
        """Arms and waits for the event, so many ns at most; False: has done nothing."""
        return False

    @classmethod
    def _doze_all(cls, readers: tuple[_PureReader, ...], ns: int, poll: int) -> bool:
        """The same for several at once; `poll` is the most where there is one that cannot be armed."""
        return False


IN_C = EXTENSION is not None
"""Whether the extension is at work."""
HAS_MANY = IN_C and bool(EXTENSION.has_many())
"""Whether a thread can sleep on the events of several readers: on 64-bit Linux 5.16 or later, with glibc."""
if TYPE_CHECKING:
    Writer: TypeAlias = _PureWriter
    Reader: TypeAlias = _PureReader
else:
    Writer, Reader = (EXTENSION.Writer, EXTENSION.Reader) if IN_C else (_PureWriter, _PureReader)


def connect_writer(
    writer: Writer, region: Region, event: Semaphore, scratch: bytearray, kind: Any, message: ctypes.Array[Any] | None
) -> None:
    """To be called once all is open. `scratch` must not move any more; the one `message` lies in it, None: too long."""
    if _has_handles(region.semaphore):
        header, place = region.header, ctypes.addressof(ctypes.c_char.from_buffer(scratch))
        ends = _address(region), region.semaphore.handle or 0, event.handle or 0, place
        sizes = header.payload_size, header.slots, header.slot_size
        writer._connect(*ends, *sizes, region.pid, _plan(kind), region.map, kind, message)


def connect_reader(reader: Reader, region: Region, long: bool) -> None:
    """The same for a subscriber; `long`: its samples become a bytearray."""
    if _has_handles(region.semaphore):
        header, lock = region.header, region.semaphore.handle or 0
        reader._connect(_address(region), lock, header.payload_size, header.slots, header.slot_size, region.pid, long)


def _plan(kind: Any) -> Plan:
    """Empty for a message that holds anything but numbers, short arrays of them and messages of such, or too many."""
    steps: list[tuple[str, int, int, int, int, int]] = []
    met = 1

    def go(kind: Any, at: int, origin: int) -> bool:
        nonlocal met
        fields = {name: inner for name, inner, *_ in kind._fields_}
        for name in kind._names_:
            shown = next(vars(base)[name] for base in kind.__mro__ if name in vars(base))
            if isinstance(shown, Elements):
                if shown.kind not in _CODES or shown.size * shown.length >= LATE_FROM:
                    return False
                count_at = 0 if shown.count_at is None else at + shown.count_at
                code, here = ord(_CODES[shown.kind]), at + shown.offset
                steps.append((name, code, here, origin, shown.length, count_at))
            elif name not in fields:
                return False  # it is shown otherwise than it lies
            elif issubclass(fields[name], ctypes.Structure):
                steps.append((name, 0, 0, origin, 0, 0))
                met += 1
                if met > MOST_OBJECTS or not go(fields[name], at + shown.offset, met - 1):
                    return False
            elif fields[name] in _CODES:
                steps.append((name, ord(_CODES[fields[name]]), at + shown.offset, origin, 0, 0))
            else:
                return False
        return True

    return tuple(steps) if go(kind, SLOT_HEADER, 0) else ()


_CODES = CODES | {ctypes.c_double: "d"}


def _has_handles(semaphore: Semaphore) -> bool:
    """Not those of posix_ipc."""
    return IN_C and (semaphore.handle is not None or isinstance(semaphore, NoSemaphore))


def _address(region: Region) -> int:
    return ctypes.addressof(ctypes.c_char.from_buffer(region.map))
