"""Count the instructions and system calls of one call of native code."""

from __future__ import annotations

import ctypes
import functools
import platform
import shutil
import subprocess
import tempfile
from pathlib import Path
from typing import Any, NamedTuple

import pytest

_CLOCK = 228
"""The number of clock_gettime, a system call only if the clock cannot be read without the kernel."""
_SAME = {5: 262}
"""The numbers of fstat: the C library uses either."""


class Counted(NamedTuple):
    """The counted instructions, and the numbers of the system calls (Linux on x86-64)."""

    instructions: int
    calls: tuple[int, ...]

    def __str__(self) -> str:
        return f"{self.instructions} instructions, system calls {list(self.calls)}"


class _Counted(ctypes.Structure):
    _fields_ = (("instructions", ctypes.c_uint64), ("calls", ctypes.c_uint64), ("numbers", ctypes.c_int64 * 256))


@functools.cache
def _counter() -> ctypes.CDLL:
    if platform.machine() != "x86_64" or not shutil.which("gcc"):
        pytest.skip("instructions are counted on x86-64, with gcc")
    with tempfile.TemporaryDirectory() as folder:
        library_file = Path(folder) / "steps.so"
        flags = ["-O1", "-Wall", "-Werror", "-mno-red-zone", "-fPIC", "-shared"]
        subprocess.run(["gcc", *flags, Path(__file__).with_suffix(".c"), "-o", library_file], check=True)
        library = ctypes.CDLL(str(library_file))
    library.count.argtypes = [ctypes.c_void_p] * 4
    return library


def _counted(function: Any, first: Any, second: Any) -> _Counted:
    into = _Counted()
    address = ctypes.cast(function, ctypes.c_void_p)
    _counter().count(address, first, second, ctypes.addressof(into))
    return into


@functools.cache
def _own() -> int:
    own = int(_counted(_counter().nothing, None, None).instructions)
    assert own > 3, "the trap flag does nothing here"
    return own


def killed_at(instruction: int, function: Any, first: Any = None, second: Any = None) -> None:
    """Call a function and kill this process after an instruction, if the call has so many. Skip as counted() does."""
    ctypes.c_uint64.in_dll(_counter(), "killed_at").value = instruction
    _counted(function, first, second)


def counted(function: Any, first: Any = None, second: Any = None) -> Counted:
    """Count one call of a C function with up to two pointers. Skip the test if counting is not possible."""
    own, count = _own(), _counted(function, first, second)
    calls = tuple(_SAME.get(number, number) for number in count.numbers[: count.calls] if number != _CLOCK)
    return Counted(count.instructions - own, calls)
