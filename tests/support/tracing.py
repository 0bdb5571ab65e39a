"""Goes through what is called instruction by instruction."""

from __future__ import annotations

import gc
import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from types import FrameType
from typing import Any


@contextmanager
def traced(trace: Callable[[FrameType, str, Any], Any]) -> Iterator[None]:
    """`trace` is as sys.settrace() takes it, for this thread; it sets `f_trace_opcodes` where it wants instructions.

    What other tests have left is not put away meanwhile: nobody would hear of an exception in there.
    """
    gc.freeze()
    sys._getframe().f_trace_opcodes = True  # Python 3.12 heeds it from the next settrace on
    sys.settrace(trace)
    try:
        yield
    finally:
        sys.settrace(None)  # Python 3.12 dies of a thread that ends traced
        gc.unfreeze()
