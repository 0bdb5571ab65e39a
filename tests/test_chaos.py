"""A short chaos test finds no fault, but detects planted faults. `make chaos` runs it for longer."""

from __future__ import annotations

import shutil
import subprocess
import sys

import pytest

from .conftest import REPOSITORY
from .rigs.chaos_faults import PLANTED


def play(*arguments: str) -> subprocess.CompletedProcess[str]:
    command = [sys.executable, "-m", "tests.rigs.chaos", *arguments]
    return subprocess.run(command, cwd=REPOSITORY, capture_output=True, text=True, check=False)


@pytest.mark.slow
@pytest.mark.skipif(shutil.which("g++") is None, reason="no g++: apt-get install g++")
def test_chaos_loses_and_tears_no_sample() -> None:
    """Allow a pause of 10 s, because other tests use the processors. `make chaos` allows only 1.2 s."""
    result = play("--seconds", "4", "--limit", "10")
    assert result.returncode == 0, result.stdout + result.stderr
    assert "nothing torn, nothing lost, nobody stuck, nothing left over" in result.stdout


@pytest.mark.sample("[completed_first]", "[not_cleared]", "[one_look]")
@pytest.mark.parametrize("fault", PLANTED)
def test_chaos_detects_a_planted_fault(fault: str) -> None:
    result = play("--seconds", "120", "--fault", fault)
    assert result.returncode == 1, result.stdout + result.stderr
    assert "Traceback" not in result.stderr, result.stderr
