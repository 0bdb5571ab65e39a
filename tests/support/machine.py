"""Lets the runtime believe that it runs on another machine, whose name stands in SHMGEN_TEST_MACHINE (`aarch64`).

For the processes of a test too. What differs by the name alone is met so, natively: whether one goes on without the
lock, and what keeps the order of loads and stores.
"""

from __future__ import annotations

import os

REAL = os.uname()
NAME = "SHMGEN_TEST_MACHINE"


def pretend() -> None:
    """To be called before the runtime is loaded."""
    if name := os.environ.get(NAME):
        os.uname = lambda: os.uname_result((*REAL[:4], name))


def keeps_order() -> bool:
    """Whether the tests believe to be on x86, where nobody waits for the lock longer than its limit."""
    return os.uname().machine in ("x86_64", "AMD64", "i686")
