"""Who dies with the lock in his hand, and who writes on: killed for real, in every combination."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
from contextlib import suppress

import pytest

from ..conftest import REPOSITORY
from ..support import machine


@pytest.mark.slow
@pytest.mark.skipif(machine.EMULATED, reason="a promise in seconds, which qemu-user does not keep")
def test_everybody_moves_within_1_3_seconds() -> None:
    """The best of three counts, where other tests take the processors."""
    command = [sys.executable, "-m", "tests.rigs.takeover", "--tries", "3"]
    with subprocess.Popen(
        command, cwd=REPOSITORY, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True, start_new_session=True
    ) as process:
        try:
            said, _ = process.communicate(timeout=280)
        finally:
            with suppress(ProcessLookupError):
                os.killpg(process.pid, signal.SIGKILL)  # its forks too
    assert process.returncode == 0, said
    assert len([line for line in said.splitlines() if line.endswith(" s")]) == 14, said
