"""Whatever lies in a definition: a schema or a diagnostic, never another exception, never a hang."""

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
"""Of CPU for one definition; it takes some milliseconds."""

real = st.randoms(use_true_random=False).map(partial(from_files, FILES))
made = st.randoms(use_true_random=False).map(from_grammar)
careless = settings(suppress_health_check=list(HealthCheck))


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return tmp_path_factory.mktemp("fuzz")


@given(real)
@settings(careless, max_examples=800)
@pytest.mark.slow
def test_real_files_that_were_damaged(folder: Path, fuzzed: Fuzzed) -> None:
    with within(SECONDS):
        read(fuzzed, folder)


@given(made)
@settings(careless, max_examples=400)
@pytest.mark.slow
def test_files_made_from_a_grammar(folder: Path, fuzzed: Fuzzed) -> None:
    with within(SECONDS):
        read(fuzzed, folder)


@pytest.mark.slow
@given(made | real)
@settings(careless, max_examples=50)
def test_what_is_generated_is_what_each_language_takes(folder: Path, fuzzed: Fuzzed) -> None:
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
def test_files_of_others_that_were_damaged(kind: str, tmp_path: Path) -> None:
    readable, dice = 0, Random(1)
    found = foreign.seeds(kind)
    for _ in range(1000):
        data = foreign.damaged(kind, dice.choice(found), dice)
        with within(SECONDS):
            readable += foreign.read(kind, data, tmp_path)
    assert readable


def test_the_guard_stops_what_hangs() -> None:
    def hang() -> None:
        while True:
            pass

    with within(0.2), pytest.raises(TooLong):
        hang()
