"""A minute of `make soak-bridge` through each backend: the bridge stays, and so does every count."""

from __future__ import annotations

import importlib.util
import os
import subprocess
import sys
from pathlib import Path

import pytest

from ..conftest import REPOSITORY
from ..support import ros1, ros2

BACKENDS = {
    "dds": lambda: importlib.util.find_spec("cyclonedds") or pytest.skip("no cyclonedds here"),
    "ros1": ros1.python,
    "ros2": lambda: ros2.prefix("jazzy"),
    "zenoh": lambda: [pytest.importorskip(package, exc_type=Exception) for package in ("zenoh", "xxhash")],
}


@pytest.mark.slow
@pytest.mark.parametrize("backend", BACKENDS)
def test_nothing_ends_it_and_nothing_is_lost_uncounted(backend: str) -> None:
    BACKENDS[backend]()
    if os.geteuid():
        pytest.skip("only root has a /dev/shm of its own made")
    command = [
        sys.executable,
        "-m",
        "tests.rigs.soak_bridge",
        "--backend",
        backend,
        "--seconds",
        "20",
        "--longest",
        "0.6",
    ]
    done = subprocess.run(command, cwd=REPOSITORY, capture_output=True, text=True, check=False, timeout=200)
    assert done.returncode == 0, done.stdout + done.stderr
    assert not list(Path("/dev/shm").glob("*soak*"))
