"""The same tests once more where the runtime believes to be on another machine: what its name alone changes.

The reference does: the lock is needed instead of gone on without, and each word is between two barriers. CI runs all
of them (slow); what
another processor really does is tests/test_machines.py's and tests/cpp/test_machines.py's, under qemu.
"""

from __future__ import annotations

import os
import subprocess
import sys

import pytest

from tests.conftest import REPOSITORY
from tests.support import machine

HERE = "tests/runtime"
WHOLE = (pytest.mark.slow, pytest.mark.timeout(1200))
ALL = [f"--ignore={HERE}/test_other_machine.py", HERE, "tests/calls/test_services.py", "tests/calls/test_actions.py"]


@pytest.mark.parametrize(
    ("name", "where"),
    [
        ("aarch64", [f"{HERE}/test_exchange.py"]),
        pytest.param("aarch64", ALL, marks=WHOLE, id="aarch64-all"),
        pytest.param("i686", ALL, marks=WHOLE, id="i686-all"),
    ],
)
def test_all_holds_there(name: str, where: list[str]) -> None:
    command = [sys.executable, "-m", "pytest", "-q", "-p", "no:cacheprovider", "-p", "no:xdist", *where]
    there = {**os.environ, machine.NAME: name, "SHMGEN_PURE": "1"}
    done = subprocess.run(command, cwd=REPOSITORY, env=there, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stdout[-4000:]
