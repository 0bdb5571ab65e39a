"""The machine on which the tests run, or which the runtime is made to believe in.

SHMGEN_TEST_MACHINE (`aarch64`) sets the machine name for the tests and their processes. So tests can run natively what
depends on the name alone: whether access without the lock is allowed, and how the order of loads and stores is kept.
SHMGEN_TEST_PATIENCE is a factor for all time limits: 20 under qemu-user.
"""

from __future__ import annotations

import os

REAL = os.uname()
NAME = "SHMGEN_TEST_MACHINE"
PATIENCE = "SHMGEN_TEST_PATIENCE"
slower = float(os.environ.get(PATIENCE, 1))
"""The factor for time limits in tests."""
EMULATED = slower > 1


def pretend() -> None:
    """Pretend to be another machine. Call this before the runtime is imported."""
    if name := os.environ.get(NAME):
        os.uname = lambda: os.uname_result((*REAL[:4], name))


def keeps_order() -> bool:
    """Return True if the tests run as on x86, where no call waits for the lock longer than its timeout."""
    return os.uname().machine in ("x86_64", "AMD64", "i686")
