"""Runs a model in the model checker spin, which visits every possible state."""

from __future__ import annotations

import re
import shutil
import subprocess
import tempfile
import time
from pathlib import Path
from typing import NamedTuple

FOLDER = Path(__file__).parent
TOOLS = ("spin", "cc")
_STATES = re.compile(r"^\s*(\d+) states, stored", re.MULTILINE)
_ERRORS = re.compile(r"errors: (\d+)")
_ERROR = re.compile(r"^pan:1: (.*?) \(at depth", re.MULTILINE)


class Run(NamedTuple):
    """A model with its settings (`WEAK`, `SAMPLES=3`, ...)."""

    model: str
    settings: str = ""

    @property
    def id(self) -> str:
        return "-".join([self.model, *self.settings.split()])


class Verdict(NamedTuple):
    """The result of a run: the error that spin reports, or `""`, the number of distinct states, and the seconds."""

    error: str
    states: int
    seconds: float


def missing() -> list[str]:
    return [tool for tool in TOOLS if shutil.which(tool) is None]


def verify(run: Run, timeout: float, large: bool = False) -> Verdict:
    """Let spin visit all states, or stop at the first error. Raise an exception if spin could not visit all states.

    A small run is not optimised, because optimising takes longer than the run.
    """
    build = ["-O2", "-DCOLLAPSE", "-DMEMLIM=12000"] if large else ["-O0", "-DMEMLIM=2000"]
    with tempfile.TemporaryDirectory(prefix="shmgen-model-") as name:
        folder = Path(name)
        for file in FOLDER.glob("*.pml"):
            shutil.copy(file, folder)
        _call(["spin", "-a", *(f"-D{setting}" for setting in run.settings.split()), f"{run.model}.pml"], folder, 60)
        _call(["cc", "-w", *build, "-DSAFETY", "-DNOCLAIM", "-o", "pan", "pan.c"], folder, 120)
        started_at = time.monotonic()
        search = ["-E", "-m100000", "-w26" if large else "-w22"]
        output = _call(["./pan", *search], folder, timeout)
        seconds = time.monotonic() - started_at
    errors, states = _ERRORS.search(output), _STATES.search(output)
    assert errors, output
    assert states, output
    if errors[1] == "0":
        for obstacle in ("max search depth too small", "out of memory", "aborted"):
            assert obstacle not in output, f"{run.id}: {output}"
        return Verdict("", int(states[1]), seconds)
    error = _ERROR.search(output)
    assert error, output
    assert "invalid array index" not in output, output
    return Verdict(error[1], int(states[1]), seconds)


def _call(command: list[str], folder: Path, timeout: float) -> str:
    result = subprocess.run(command, cwd=folder, capture_output=True, text=True, timeout=timeout, check=False)
    output = result.stdout + result.stderr
    assert result.returncode == 0, f"{' '.join(command)}: {output}"
    return output
