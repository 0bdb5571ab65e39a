"""Structured Text that is written by hand: it stands as it is, one object a file, and an IDE can open it there."""

from __future__ import annotations

import re

import pytest

from shmgen.generator.render import render
from shmgen.targets.st import common

from ..conftest import REPOSITORY
from ..softplc import compile_st

FILES = sorted((REPOSITORY / "templates" / "st").glob("*.st"))
NAMES = [path.stem for path in FILES]


def test_there_are_blocks_enumerations_a_list_and_a_structure() -> None:
    assert " ".join(NAMES) == (
        "E_ShmError E_ShmState FB_ShmClient FB_ShmRegion FB_ShmServer GVL_ShmClock ST_shmgen_Time"
    )


@pytest.mark.parametrize("path", FILES, ids=NAMES)
def test_it_has_no_hole(path) -> None:
    text = path.read_text(encoding="ascii")
    assert not re.search(r"\{[{%#]", text)
    (copy,) = render(common.by_hand(path.stem)).values()
    assert copy == text


@pytest.mark.parametrize("path", FILES, ids=NAMES)
def test_it_is_the_object_that_its_file_is_named_after(path) -> None:
    objects = re.findall(r"^(TYPE|FUNCTION_BLOCK|VAR_GLOBAL)(?: (\w+))?", path.read_text(), re.MULTILINE)
    assert [name or path.stem for _, name in objects] == [path.stem]  # a list has its name from the file alone


@pytest.mark.slow
def test_the_soft_plc_reads_it_where_it_stands() -> None:
    """With the two structures and the list that are made from abi.py, nothing is missing."""
    made = render(common.plan(locks=True, struct_time=False))
    lists = {path: text for path, text in made.items() if re.search(r"/(ST_|GVL_Shm\.)", path)}
    plc = compile_st(lists | {str(path): path.read_text() for path in FILES})
    region = plc.block("FB_ShmRegion")
    assert region.method("Init", sTopic="1st", sTypeName="a/msg/B", udiPayloadSize=8, udiSizeOf=8, udiDepth=1) is False
    assert region.eErrorID == "TOPIC_INVALID"


@pytest.mark.parametrize("locks", [True, False])
def test_whether_there_is_a_lock_is_a_constant(locks: bool) -> None:
    texts = render(common.plan(locks=locks, struct_time=False))
    said = [path for path, text in texts.items() if f"LOCKS         : BOOL := {str(locks).upper()};" in text]
    assert said == ["st/shmgen/GVL_Shm.st"]
    other = render(common.plan(locks=not locks, struct_time=False))
    assert [path for path in texts if texts[path] != other[path]] == said
