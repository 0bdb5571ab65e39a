"""A short load test succeeds. `make load` runs it for longer."""

from __future__ import annotations

import subprocess
import sys

import pytest

from .conftest import REPOSITORY


@pytest.mark.slow
def test_64_topics_at_1_khz_need_no_more_memory() -> None:
    command = [sys.executable, "-m", "tests.rigs.load", "--seconds", "3"]
    result = subprocess.run(command, cwd=REPOSITORY, capture_output=True, text=True, check=False)
    assert result.returncode == 0, result.stdout + result.stderr
