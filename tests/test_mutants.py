"""A mutant that a test detects is killed, another one lives, and mutants.toml explains only existing mutants."""

from __future__ import annotations

import tempfile
from pathlib import Path

import pytest

from .conftest import REPOSITORY
from .rigs.mutants import plan
from .support.mutation_worker import CODE, Worker
from .support.mutations import mutants_of

TEXT = b"""def first(a: int = 1) -> int:
    assert a < 9
    if a < 2 and not a:
        raise ValueError(f"{a + 1}")
    return a + 3
"""


def test_mutations_of_a_function() -> None:
    mutants = mutants_of("x.py", TEXT)
    assert {(mutant.line, mutant.was, mutant.now) for mutant in mutants} == {
        (1, "1", "(2)"),
        (3, "a < 2 and not a", "(a < 2 or not a)"),
        (3, "a < 2", "(a <= 2)"),
        (3, "2", "(3)"),
        (3, "not a", "(a)"),
        (4, 'raise ValueError(f"{a + 1}")', "pass"),
        (5, "return a + 3", "return None"),
        (5, "a + 3", "(a - 3)"),
        (5, "3", "(4)"),
    }
    for mutant in mutants:
        compile(mutant.apply(TEXT), "x.py", "exec")


BOUNDS = "generator/bounds.py"


def test_harmless_mutants_exist() -> None:
    groups, harmless = plan()
    every = {mutant.key for group in groups for file in group.files for mutant in mutants_of(file, read(file))}
    assert len(every) > 1500
    assert harmless.keys() - every == set()
    assert all(harmless.values())


@pytest.mark.slow
def test_mutant_is_killed_by_a_test_that_detects_it() -> None:
    test = ["tests/definitions/test_bounds.py"]
    detected, explained = (
        next(mutant for mutant in mutants_of(file, read(file)) if (mutant.where, mutant.was) == change)
        for file, change in ((BOUNDS, ("_most_specific", "key in table")), ("generator/layout.py", ("_message", "0")))
    )
    with tempfile.TemporaryDirectory() as folder:
        worker = Worker(Path(folder))
        try:
            assert worker.learn(test, [BOUNDS])[0] > 0
            assert [worker.try_(mutant, test, 60) for mutant in (detected, explained)] == ["killed", "lives"]
            assert (worker.copy / CODE / BOUNDS).read_bytes() == read(BOUNDS)
        finally:
            worker.close()


def read(file: str) -> bytes:
    return (REPOSITORY / CODE / file).read_bytes()
