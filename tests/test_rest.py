"""The option `--rest` runs only tests that did not pass in the previous run, so that `.ci/run` repeats none."""

from __future__ import annotations

import re
import subprocess
import sys
from pathlib import Path

import pytest

from .conftest import REPOSITORY

TESTS = """
import os, pytest
def test_passes(): pass
def test_fails_at_first(): assert os.path.exists("made")
@pytest.mark.slow
def test_slow(): pass
"""


def run(folder: Path, *words: str) -> list[str]:
    command = [sys.executable, "-m", "pytest", "-p", "tests.conftest", "-c", "pytest.ini", "-v", *words]
    done = subprocess.run(
        command,
        cwd=folder,
        env={"PYTHONPATH": str(REPOSITORY), "PATH": ""},
        capture_output=True,
        text=True,
        check=False,
    )
    lines = [line for line in done.stdout.splitlines() if re.search("PASSED|FAILED .*%", line)]
    return re.findall(r"::(test_\w+)", "\n".join(lines))


@pytest.mark.slow
def test_rest_runs_no_test_that_passed(tmp_path: Path) -> None:
    (tmp_path / "pytest.ini").write_text("[pytest]\nmarkers = slow\n")
    (tmp_path / "test_some.py").write_text(TESTS)
    assert run(tmp_path, "-n", "0", "-m", "not slow") == ["test_passes", "test_fails_at_first"]
    (tmp_path / "made").touch()
    assert run(tmp_path, "-n", "0", "--last-failed", "-m", "not slow") == ["test_fails_at_first"]
    assert sorted(run(tmp_path, "-n", "2", "--rest")) == ["test_slow"]
    assert run(tmp_path, "-n", "0", "--rest") == []
