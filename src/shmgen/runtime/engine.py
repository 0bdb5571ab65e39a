"""Chooses the engine, the code that reads and writes regions: the extension in C, or the same in plain Python.

Both engines have a Writer, a Reader, a Notifier, sleep_any() and can_wait_for_many(), and raise the same errors.
"""

from __future__ import annotations

import ctypes
import os
import sys
import weakref
from typing import TYPE_CHECKING, Any

from shmgen.core import abi
from shmgen.runtime.messages.steps import has_table
from shmgen.runtime.messages.walker import TOOLS

if TYPE_CHECKING:
    from shmgen.runtime import reference as engine

    IN_C: bool
    """True if the extension is in use."""
else:
    try:
        if os.environ.get("SHMGEN_PURE") or "t" in getattr(sys, "abiflags", ""):  # free-threaded: other object layout
            raise ImportError
        from shmgen import _core as engine

        if engine.ABI != abi.ABI:
            raise ImportError
        IN_C = True
    except ImportError:
        from shmgen.runtime import reference as engine

        IN_C = False

Writer = engine.Writer
Reader = engine.Reader
Notifier = engine.Notifier
sleep_any = engine.sleep_any
can_wait_for_many = engine.can_wait_for_many


def codec(kind: Any) -> Any:
    """Return the table of fields of the message class `kind`, converted for the extension in C.

    Each table is converted once. Return None if the extension is missing or if `kind` has no table.
    """
    if not IN_C:
        return None
    if kind not in _codecs:
        make = getattr(engine, "Table")  # noqa: B009 the reference has none
        _codecs[kind] = make(kind, ctypes.sizeof(kind), TOOLS) if has_table(kind) else None
    return _codecs[kind]


_codecs: weakref.WeakKeyDictionary[Any, Any] = weakref.WeakKeyDictionary()
