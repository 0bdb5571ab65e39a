"""Forbid a system call in this process."""

from __future__ import annotations

import ctypes

_NO_NEW_PRIVS = 38
_SET_SECCOMP = 22
_FILTER = 2
_KILL = 0x80000000
_ERRNO = 0x00050000
_ALLOW = 0x7FFF0000


class _Step(ctypes.Structure):
    _fields_ = (("code", ctypes.c_ushort), ("jt", ctypes.c_ubyte), ("jf", ctypes.c_ubyte), ("k", ctypes.c_uint))


class _Program(ctypes.Structure):
    _fields_ = (("len", ctypes.c_ushort), ("filter", ctypes.POINTER(_Step)))


def forbid(call: int, error: int = 0) -> None:
    """Make a system call fail with the errno `error`, or kill the process."""
    # Load the number of the system call; refuse if it is that one; allow.
    refuse = _ERRNO | error if error else _KILL
    steps = (_Step * 4)((0x20, 0, 0, 0), (0x15, 0, 1, call), (0x06, 0, 0, refuse), (0x06, 0, 0, _ALLOW))
    libc = ctypes.CDLL(None, use_errno=True)
    assert libc.prctl(_NO_NEW_PRIVS, 1, 0, 0, 0) == 0
    assert libc.prctl(_SET_SECCOMP, _FILTER, ctypes.byref(_Program(len(steps), steps))) == 0
