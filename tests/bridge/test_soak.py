"""Run `make soak-bridge` for 20 s through each backend: the bridge survives, and every message is counted."""

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


@pytest.mark.sample("[ros2]")
@pytest.mark.parametrize("backend", BACKENDS)
def test_bridge_survives_a_soak_and_counts_every_message(backend: str) -> None:
    BACKENDS[backend]()
    if os.geteuid():
        pytest.skip("requires root to mount a private /dev/shm")
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
    result = subprocess.run(command, cwd=REPOSITORY, capture_output=True, text=True, check=False, timeout=200)
    assert result.returncode == 0, result.stdout + result.stderr
    assert not list(Path("/dev/shm").glob("*soak*"))
