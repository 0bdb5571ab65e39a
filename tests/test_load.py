"""The load test, short; `make load` is the long one."""

from __future__ import annotations

import subprocess
import sys

import pytest

from .conftest import REPOSITORY


@pytest.mark.slow
def test_64_topics_at_1_khz_do_not_grow() -> None:
    command = [sys.executable, "-m", "tests.rigs.load", "--seconds", "3"]
    result = subprocess.run(command, cwd=REPOSITORY, capture_output=True, text=True, check=False)
    assert result.returncode == 0, result.stdout + result.stderr
