"""Check the handwritten Structured Text: one object per file, without placeholders, so that an IDE can open it."""

from __future__ import annotations

import re

import pytest

from shmgen.generator.render import render
from shmgen.targets.st import common

from ..conftest import REPOSITORY
from ..softplc import compile_st

TEMPLATES = sorted((REPOSITORY / "templates" / "st").glob("*.st"))
NAMES = [path.stem for path in TEMPLATES]


def test_templates_contain_each_kind_of_object() -> None:
    assert " ".join(NAMES) == (
        "E_ShmError E_ShmState FB_ShmClient FB_ShmRegion FB_ShmServer GVL_ShmClock ST_shmgen_Time"
    )


@pytest.mark.parametrize("path", TEMPLATES, ids=NAMES)
def test_template_has_no_placeholder(path) -> None:
    text = path.read_text(encoding="ascii")
    assert not re.search(r"\{[{%#]", text)
    (copy,) = render(common.by_hand(path.stem)).values()
    assert copy == text


@pytest.mark.parametrize("path", TEMPLATES, ids=NAMES)
def test_template_defines_the_object_of_its_name(path) -> None:
    objects = re.findall(r"^(TYPE|FUNCTION_BLOCK|VAR_GLOBAL)(?: (\w+))?", path.read_text(), re.MULTILINE)
    assert [name or path.stem for _, name in objects] == [path.stem]  # only the file name determines the name of a list


@pytest.mark.slow
def test_soft_plc_compiles_the_templates() -> None:
    """Compile the templates together with the two structures and the list generated from abi.py."""
    rendered = render(common.plan(locks=True, struct_time=False))
    declarations = {path: text for path, text in rendered.items() if re.search(r"/(ST_|GVL_Shm\.)", path)}
    plc = compile_st(declarations | {str(path): path.read_text() for path in TEMPLATES})
    region = plc.block("FB_ShmRegion")
    assert region.method("Init", sTopic="1st", sTypeName="a/msg/B", udiPayloadSize=8, udiSizeOf=8, udiDepth=1) is False
    assert region.eErrorID == "TOPIC_INVALID"


@pytest.mark.parametrize("locks", [True, False])
def test_lock_setting_is_one_constant(locks: bool) -> None:
    texts = render(common.plan(locks=locks, struct_time=False))
    paths = [path for path, text in texts.items() if f"LOCKS         : BOOL := {str(locks).upper()};" in text]
    assert paths == ["st/shmgen/GVL_Shm.st"]
    opposite = render(common.plan(locks=not locks, struct_time=False))
    assert [path for path in texts if texts[path] != opposite[path]] == paths
