"""Who dies with the lock in his hand, and who writes on: killed for real, in every combination."""

from __future__ import annotations

import subprocess
import sys

import pytest

from ..conftest import REPOSITORY


@pytest.mark.slow
@pytest.mark.skipif(sys.maxsize < 2**32, reason="the soft PLC is not to be had on 32-bit machines")
def test_everybody_moves_within_1_3_seconds() -> None:
    """The best of three counts, where other tests take the processors."""
    command = [sys.executable, "-m", "tests.takeover", "--tries", "3"]
    result = subprocess.run(command, cwd=REPOSITORY, capture_output=True, text=True, check=False)
    assert result.returncode == 0, result.stdout + result.stderr
    assert len(result.stdout.splitlines()) == 14
