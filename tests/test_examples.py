"""Every example runs, and leaves nothing behind."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import pytest

from .conftest import REPOSITORY

SAYS = {
    "moving_pose": "400 poses crossed",
    "softplc_echo": "received by the PLC",
}


def test_all_examples_are_here() -> None:
    assert {path.parent.name for path in (REPOSITORY / "examples").glob("*/demo.py")} == set(SAYS)


@pytest.mark.parametrize("example", sorted(set(SAYS) - {"softplc_echo"}))  # that one is `make demo`, see test_readme.py
def test_example(example: str) -> None:
    environment = {**os.environ, "PATH": f"{Path(sys.executable).parent}:{os.environ['PATH']}"}
    command = [sys.executable, REPOSITORY / "examples" / example / "demo.py"]
    result = subprocess.run(command, env=environment, capture_output=True, text=True, check=False, timeout=240)
    assert result.returncode == 0, result.stdout + result.stderr
    assert SAYS[example] in result.stdout
    assert not list(Path("/dev/shm").glob("*shmgen_demo*"))
