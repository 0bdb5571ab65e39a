"""Chooses the engine: the C headers behind the extension, or the reference in Python.

Both have a Writer, a Reader, sleep_any() and can_wait_for_many(), and raise the same errors.
"""

from __future__ import annotations

import os
import sys
import weakref
from typing import TYPE_CHECKING, Any

from shmgen.core import abi

if TYPE_CHECKING:
    from shmgen.runtime import reference as engine
    from shmgen.runtime.messages import plan

    IN_C: bool
    """Whether the extension is at work."""
else:
    try:
        if os.environ.get("SHMGEN_PURE") or "t" in getattr(sys, "abiflags", ""):  # objects of 3.13t look otherwise
            raise ImportError
        from shmgen import _core as engine

        if engine.ABI != abi.ABI:
            raise ImportError
        from shmgen.runtime.messages import plan
        from shmgen.runtime.refusals import refusal

        engine.explain_by(refusal)
        IN_C = True
    except ImportError:
        from shmgen.runtime import reference as engine

        IN_C = False

Writer = engine.Writer
Reader = engine.Reader
sleep_any = engine.sleep_any
can_wait_for_many = engine.can_wait_for_many


def codec(kind: Any) -> Any:
    """What moves messages of that class to bytes and back in C, made once; None: the class does so itself."""
    if not IN_C:
        return None
    if kind not in _codecs:
        _codecs[kind] = plan.codec(getattr(engine, "Codec"), kind)  # noqa: B009 the reference has none
    return _codecs[kind]


_codecs: weakref.WeakKeyDictionary[Any, Any] = weakref.WeakKeyDictionary()
