"""Type-check the backend ros2 with each distribution's rclpy; `make lint` has no rclpy and treats it as Any."""

from __future__ import annotations

import subprocess
import sys

import pytest

from ..conftest import REPOSITORY
from ..support import ros2


@pytest.mark.parametrize("distribution", ros2.DISTRIBUTIONS)
def test_ros2_backend_type_checks_with_rclpy(distribution: str) -> None:
    files = sorted((REPOSITORY / "src" / "shmgen" / "bridge" / "ros2").glob("*.py"))
    python = ros2.prefix(distribution) / "bin" / "python"
    # Parts of rclpy have no annotations, and its __init__ exports what it imports.
    loose = ["--implicit-reexport", "--allow-untyped-calls", "--cache-dir", f".mypy_cache/{distribution}"]
    command = [sys.executable, "-m", "mypy", "--python-executable", python, *loose, *files]
    result = subprocess.run(command, cwd=REPOSITORY, capture_output=True, text=True)
    assert result.returncode == 0, result.stdout
