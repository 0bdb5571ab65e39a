"""Which machine the tests run on, or let the runtime believe that it runs on.

A name in SHMGEN_TEST_MACHINE (`aarch64`) is believed, by the processes of a test too. What differs by the name alone is
met so, natively: whether one goes on without the lock, and what keeps the order of loads and stores.
SHMGEN_TEST_PATIENCE says how many times as long all takes there: 20 under qemu-user.
"""

from __future__ import annotations

import os

REAL = os.uname()
NAME = "SHMGEN_TEST_MACHINE"
PATIENCE = "SHMGEN_TEST_PATIENCE"
slower = float(os.environ.get(PATIENCE, 1))
"""What limits of tests are multiplied with."""
EMULATED = slower > 1


def pretend() -> None:
    """To be called before the runtime is loaded."""
    if name := os.environ.get(NAME):
        os.uname = lambda: os.uname_result((*REAL[:4], name))


def keeps_order() -> bool:
    """Whether the tests believe to be on x86, where nobody waits for the lock longer than its limit."""
    return os.uname().machine in ("x86_64", "AMD64", "i686")
