"""Says so on another Python than CPython: ctypes and fcntl of others lack what the runtime is built on."""

from __future__ import annotations

import sys

if sys.implementation.name != "cpython":
    raise ImportError(
        f"shmgen.runtime needs CPython 3.10 or later, and this is {sys.implementation.name}: its structures take other "
        "names, and it has no record locks that go with a descriptor (F_OFD_SETLK); start this with python3"
    )
