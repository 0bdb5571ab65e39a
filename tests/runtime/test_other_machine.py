"""Run the runtime's tests with the name of another machine, which changes the reference.

On aarch64, the reference needs the lock and puts barriers around each access. On i686, it has neither the futex nor
the barrier between processes. tests/test_machines.py and tests/cpp/test_machines.py run other processors under qemu.
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
        pytest.param("i686", ["-m", "not slow", *ALL], marks=WHOLE, id="i686-all"),
    ],
)
@pytest.mark.slow
def test_all_holds_there(name: str, where: list[str]) -> None:
    command = [sys.executable, "-m", "pytest", "-q", "-p", "no:cacheprovider", "-p", "no:xdist", *where]
    there = {**os.environ, machine.NAME: name, "SHMGEN_PURE": "1"}
    done = subprocess.run(command, cwd=REPOSITORY, env=there, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stdout[-4000:]
