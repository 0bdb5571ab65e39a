"""Any text of a definition results in a schema or a diagnostic, without another exception or a hang."""

from __future__ import annotations

import tempfile
from functools import partial
from pathlib import Path
from random import Random

import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from lxml import etree

from tests.conftest import REPOSITORY, SHARED
from tests.softplc.reading import read as read_st
from tests.support import foreign
from tests.support.build import compile_headers, put
from tests.support.definitions import Fuzzed, from_files, from_grammar, generated, read
from tests.support.guard import TooLong, within

FILES = sorted(
    [*(SHARED / "corpus").glob("*/*/*/*.[msa]*"), *(REPOSITORY / "tests" / "cases").glob("*/msgs/*/*/*.[msa]*")]
)
SECONDS = 10
"""CPU time for one definition, which usually takes some milliseconds."""

damaged_definitions = st.randoms(use_true_random=False).map(partial(from_files, FILES))
grammar_definitions = st.randoms(use_true_random=False).map(from_grammar)
no_health_checks = settings(suppress_health_check=list(HealthCheck))


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return tmp_path_factory.mktemp("fuzz")


@given(damaged_definitions)
@settings(no_health_checks, max_examples=800)
@pytest.mark.slow
def test_damaged_definitions_do_not_crash(folder: Path, fuzzed: Fuzzed) -> None:
    with within(SECONDS):
        read(fuzzed, folder)


@given(grammar_definitions)
@settings(no_health_checks, max_examples=400)
@pytest.mark.slow
def test_definitions_from_a_grammar_do_not_crash(folder: Path, fuzzed: Fuzzed) -> None:
    with within(SECONDS):
        read(fuzzed, folder)


@pytest.mark.slow
@given(grammar_definitions | damaged_definitions)
@settings(no_health_checks, max_examples=50)
def test_generated_files_are_valid_in_each_language(folder: Path, fuzzed: Fuzzed) -> None:
    with within(SECONDS):
        texts = generated(fuzzed, folder, ("python", "st", "plcopen", "c"))
    if texts:
        assert_well_formed(texts)


def assert_well_formed(texts: dict[str, str]) -> None:
    headers = {path: text for path, text in texts.items() if path.endswith(".h")}
    for path, text in texts.items():
        if path.endswith(".py"):
            compile(text, path, "exec")
        elif path.endswith(".xml"):
            etree.fromstring(text.encode())
    structures = {path: text for path, text in texts.items() if path.startswith("st/demo_msgs/") and "FB_" not in path}
    assert len(read_st(structures)) >= len(structures)
    with tempfile.TemporaryDirectory() as folder:
        put(headers, Path(folder))
        compile_headers(Path(folder))


@pytest.mark.parametrize("kind", foreign.KINDS)
@pytest.mark.family("[mcap]")
def test_damaged_foreign_files_do_not_crash(kind: str, tmp_path: Path) -> None:
    readable, dice = 0, Random(1)
    seeds = foreign.seeds(kind)
    for _ in range(1000):
        data = foreign.damaged(kind, dice.choice(seeds), dice)
        with within(SECONDS):
            readable += foreign.read(kind, data, tmp_path)
    assert readable


def test_guard_stops_a_hang() -> None:
    def hang() -> None:
        while True:
            pass

    with within(0.2), pytest.raises(TooLong):
        hang()
