"""Replaces the program under a running block, as an online change of CODESYS does.

The steps are those of the CODESYS help ("FB_Init, FB_Reinit, FB_Exit"): FB_Exit of the old instance with bInCopyCode,
FB_Init of the new instance, a copy of each member whose name and type are the same in both, and FB_Reinit. Handles and
mapped memory stay, because they belong to the process.
"""

from __future__ import annotations

import ctypes
from collections.abc import Iterator
from typing import Any

from tests.softplc.iec import Array, Named, Type
from tests.softplc.plc import Block, Plc, View, size_of


def online_change(old: Block, plc: Plc) -> Block:
    """Return the instance in `plc` that continues the work of `old`. The caller must not call `old` again."""
    _each(old, "FB_Exit", bInCopyCode=True)
    new = plc.block(old._name)
    _each(new, "FB_Init", bInitRetains=False, bInCopyCode=True)
    _copy(old, new)
    _each(new, "FB_Reinit")
    return new


def change_globals(old: View, new: View) -> None:
    """Do an online change of all blocks in a variable list."""
    for block in _within(old):
        _each(block, "FB_Exit", bInCopyCode=True)
    _copy(old, new)
    for block in _within(new):
        _each(block, "FB_Reinit")


def _each(block: Block, method: str, **inputs: Any) -> None:
    """Call a method of the block and of all blocks inside it that have this method."""
    for one in (block, *_within(block)):
        if one.plc.runs(one._name, method):
            one.method(method, **inputs)


def _within(view: View) -> Iterator[Block]:
    for name, type_ in view._plc.types[view._name].items():
        inner = getattr(view, name) if isinstance(type_, Named) else None
        if isinstance(inner, Block):
            yield inner
            yield from _within(inner)


def _copy(old: View, new: View) -> None:
    types = old._plc.types[old._name]
    for name, type_ in new._plc.types[new._name].items():
        if types.get(name) == type_:
            _copy_value(type_, old, old._find(name)[1], new, new._find(name)[1])


def _copy_value(type_: Type, old: View, source: int, new: View, target: int) -> None:
    match type_:
        case Named(name) if name not in new._plc.enumerations:  # a type of this name may differ now
            _copy(View(old._plc, name, source), View(new._plc, name, target))
        case Array(of=of, first=first, last=last):
            for at in range(last - first + 1):
                _copy_value(of, old, source + at * size_of(old._plc, of), new, target + at * size_of(new._plc, of))
        case _:
            ctypes.memmove(target, source, size_of(new._plc, type_))
