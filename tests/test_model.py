"""The protocol as a model: spin finds nothing, but finds what is planted in it. `make model` goes further."""

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
"""Seconds; each takes some, but other tests take the processors."""


@pytest.mark.parametrize("run", HOLDS, ids=lambda run: run.id)
def test_no_state_breaks_what_is_promised(run: Run) -> None:
    assert verify(run, TIMEOUT).error == ""


@pytest.mark.parametrize("run", FAULTS, ids=lambda run: run.id)
def test_a_planted_fault_is_found(run: Run) -> None:
    assert verify(run, TIMEOUT).error


@pytest.mark.parametrize("run", REMAINS, ids=lambda run: run.id)
def test_what_the_page_says_remains_is_there(run: Run) -> None:
    assert verify(run, TIMEOUT).error


def test_each_fault_that_can_be_planted_is_tried() -> None:
    from .model.spin import FOLDER

    text = "".join(file.read_text() for file in FOLDER.glob("*.pml"))
    planted = {word.strip("()!") for word in text.replace("(", " ").replace(")", " ").split() if word.startswith("F_")}
    tried = {setting for run in FAULTS + REMAINS for setting in run.settings.split() if setting.startswith("F_")}
    assert planted == tried


def test_no_run_is_listed_twice() -> None:
    runs = [run.id for run in HOLDS + LARGE + FAULTS + REMAINS]
    assert len(runs) == len(set(runs))
