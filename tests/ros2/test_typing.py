"""The backend ros2 type-checks against each rclpy itself; `make lint` has none, and takes all of it for Any."""

from __future__ import annotations

import subprocess
import sys

import pytest

from ..conftest import REPOSITORY
from ..support import ros2


@pytest.mark.parametrize("distribution", ros2.DISTRIBUTIONS)
def test_against_the_real_one(distribution: str) -> None:
    files = sorted((REPOSITORY / "src" / "shmgen" / "bridge").glob("ros2*.py"))
    python = ros2.prefix(distribution) / "bin" / "python"
    # Parts of rclpy have no annotations, and its __init__ exports what it imports.
    loose = ["--implicit-reexport", "--allow-untyped-calls", "--cache-dir", f".mypy_cache/{distribution}"]
    command = [sys.executable, "-m", "mypy", "--python-executable", python, *loose, *files]
    done = subprocess.run(command, cwd=REPOSITORY, capture_output=True, text=True)
    assert done.returncode == 0, done.stdout
