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
LONG_RUN = (pytest.mark.exhaustive, pytest.mark.timeout(1200))
ALL = [f"--ignore={HERE}/test_other_machine.py", HERE, "tests/calls/test_services.py", "tests/calls/test_actions.py"]


@pytest.mark.parametrize(
    ("name", "tests"),
    [
        pytest.param("aarch64", [f"{HERE}/test_exchange.py"], marks=pytest.mark.slow),
        pytest.param("aarch64", ALL, marks=LONG_RUN, id="aarch64-all"),
        pytest.param("i686", ["-m", "not slow", *ALL], marks=LONG_RUN, id="i686-all"),
    ],
)
def test_runtime_tests_pass_as_another_machine(name: str, tests: list[str]) -> None:
    command = [sys.executable, "-m", "pytest", "-q", "-p", "no:cacheprovider", "-p", "no:xdist", *tests]
    environment = {**os.environ, machine.NAME: name, "SHMGEN_PURE": "1"}
    done = subprocess.run(command, cwd=REPOSITORY, env=environment, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stdout[-4000:]
