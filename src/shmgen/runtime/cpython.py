"""Importing this module raises ImportError if Python is not CPython, the only Python that shmgen supports.

Other Pythons lack features of ctypes and fcntl that shmgen needs.
"""

from __future__ import annotations

import sys

if sys.implementation.name != "cpython":
    raise ImportError(
        f"shmgen.runtime needs CPython 3.10 or later, and this is {sys.implementation.name}: its structures take other "
        "names, and it has no record locks that go with a descriptor (F_OFD_SETLK); start this with python3"
    )
