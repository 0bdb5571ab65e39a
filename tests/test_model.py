"""spin finds no fault in the model of the protocol, but detects planted faults. `make model` checks more states."""

from __future__ import annotations

import shutil

import pytest

from .model.runs import FAULTS, HOLDS, LARGE, REMAINS
from .model.spin import TOOLS, Run, verify

pytestmark = [pytest.mark.slow] + [
    pytest.mark.skipif(shutil.which(tool) is None, reason=f"{tool} is not installed: the model is not checked")
    for tool in TOOLS
]
TIMEOUT = 300.0
"""Seconds for one run. A run takes only some seconds if no other test uses the processors."""


@pytest.mark.parametrize("run", HOLDS, ids=lambda run: run.id)
def test_model_has_no_fault(run: Run) -> None:
    assert verify(run, TIMEOUT).error == ""


@pytest.mark.parametrize("run", FAULTS, ids=lambda run: run.id)
def test_model_detects_a_planted_fault(run: Run) -> None:
    assert verify(run, TIMEOUT).error


@pytest.mark.parametrize("run", REMAINS, ids=lambda run: run.id)
def test_documented_limitations_exist_in_the_model(run: Run) -> None:
    assert verify(run, TIMEOUT).error


def test_all_faults_of_the_model_are_planted() -> None:
    from .model.spin import FOLDER

    text = "".join(file.read_text() for file in FOLDER.glob("*.pml"))
    planted = {word.strip("()!") for word in text.replace("(", " ").replace(")", " ").split() if word.startswith("F_")}
    tried = {setting for run in FAULTS + REMAINS for setting in run.settings.split() if setting.startswith("F_")}
    assert planted == tried


def test_no_run_is_listed_twice() -> None:
    runs = [run.id for run in HOLDS + LARGE + FAULTS + REMAINS]
    assert len(runs) == len(set(runs))
