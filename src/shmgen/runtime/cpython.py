"""Importing this module raises ImportError if Python is not CPython, the only Python that shmgen supports.

Other Pythons lack features of ctypes and fcntl that shmgen needs.
"""

from __future__ import annotations

import sys

if sys.implementation.name != "cpython":
    raise ImportError(
        f"shmgen.runtime needs CPython 3.10 or later, but this is {sys.implementation.name}, which lacks features of "
        "ctypes and fcntl: start this program with python3"
    )
