"""Trace Python code instruction by instruction."""

from __future__ import annotations

import gc
import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from types import FrameType
from typing import Any


@contextmanager
def traced(trace: Callable[[FrameType, str, Any], Any]) -> Iterator[None]:
    """Trace this thread with `trace`, an argument of sys.settrace() that sets `f_trace_opcodes` to trace instructions.

    Freeze the garbage of other tests meanwhile: an exception in a finalizer would be lost.
    """
    gc.freeze()
    sys._getframe().f_trace_opcodes = True  # Python 3.12 heeds it from the next settrace on
    sys.settrace(trace)
    try:
        yield
    finally:
        sys.settrace(None)  # Python 3.12 dies of a thread that ends traced
        gc.unfreeze()
