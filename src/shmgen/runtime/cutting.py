"""Turns assignments of texts that do not fit into a count: what messages with `overflow = "truncate"` do besides."""

from __future__ import annotations

import ctypes
from collections.abc import Iterator
from inspect import getattr_static
from typing import Any

from shmgen.runtime.message import CUT, Late, Message


class CuttingMessage(Message):
    """A message that cuts texts when they are assigned, and remembers which, for the publisher to count."""

    def __setattr__(self, name: str, value: Any) -> None:
        super().__setattr__(name, value)
        member = getattr_static(type(self), name, None)
        size = getattr(member, "size", None)
        if member is None or size is None or isinstance(value, (int, float)):
            return
        whole, start = _whole(self)
        start += member.offset
        former = set(range(start, start + size * getattr(member, "length", 1)))
        cut = {start + offset for offset in _cuts(getattr(self, name), value, size)}
        whole.__dict__["_cuts"] = (whole.__dict__.get("_cuts", set()) - former) | cut

    @classmethod
    def _encode_counted(cls, message: Any, into: bytearray, at: int, late: Late) -> None:
        """As _encode, and says in `late` which texts were cut, now or when they were assigned."""
        if type(message) is cls:
            into[at : at + ctypes.sizeof(cls)] = bytes(message)
            late += [CUT] * sum(1 for _ in _cuts(message, message, 0))
        else:
            cls._encode(message, into, at, late)


def _cuts(stored: Any, given: Any, item: int) -> Iterator[int]:
    """Offsets in `stored` of texts that are not what was given; `item` is the size of an element in bytes."""
    if isinstance(stored, str):
        yield from () if stored == given else (0,)
    elif isinstance(stored, CuttingMessage) and type(given) is type(stored):
        whole, start = _whole(given)
        within = range(start, start + ctypes.sizeof(given))
        yield from (offset - start for offset in whole.__dict__.get("_cuts", ()) if offset in within)
    elif isinstance(stored, CuttingMessage):
        for name in stored._names_:
            member = getattr_static(type(stored), name)
            size = getattr(member, "size", 0)
            inner = _cuts(getattr(stored, name), getattr(given, name), size) if size else ()
            yield from (member.offset + offset for offset in inner)
    elif isinstance(stored, (list, ctypes.Array)):
        for index, pair in enumerate(zip(stored, given, strict=True)):
            yield from (index * item + offset for offset in _cuts(*pair, item))


def _whole(part: Any) -> tuple[Any, int]:
    """The object whose memory `part` lies in, and where in it."""
    whole = part
    while True:
        views = [kept for kept in (whole._objects or {}).values() if isinstance(kept, memoryview)]  # of from_buffer()
        owner = whole._b_base_ or (views[0].obj if views else None)
        if not isinstance(owner, (ctypes.Structure, ctypes.Array)):
            return whole, ctypes.addressof(part) - ctypes.addressof(whole)
        whole = owner
