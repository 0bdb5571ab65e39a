"""Test the reader of handwritten Structured Text, which accepts one style and rejects all others."""

from __future__ import annotations

import pytest

from shmgen.targets.st.objects import Attribute, DataType, GlobalList, Unit
from shmgen.targets.st.reader import NotInStyle, read

from ..conftest import REPOSITORY

BLOCK = """\
// What it is.
FUNCTION_BLOCK FB_A
VAR_INPUT
    xEnable : BOOL := TRUE;  // on
END_VAR
VAR
    // Where
    // it is.
    _s : STRING(80) := 'a;//b';
END_VAR

xEnable := FALSE;

END_FUNCTION_BLOCK

METHOD PRIVATE Work : BOOL
Work := TRUE;
END_METHOD
"""
ENUM = "{attribute 'strict'}\nTYPE E_A :\n(\n    CLOSED := 0,  // shut\n    OPEN := 1\n) UDINT := CLOSED;\nEND_TYPE\n"
STRUCT = "// Two.\n{attribute 'pack_mode' := '8'}\nTYPE ST_A :\nSTRUCT\n    a : UINT;  // 0\nEND_STRUCT\nEND_TYPE\n"
LIST = "VAR_GLOBAL CONSTANT\n    A : UDINT := 1;\nEND_VAR\n"


def test_reader_parses_handwritten_objects() -> None:
    block = read("FB_A", BLOCK)
    assert isinstance(block, Unit)
    assert [section.keyword for section in block.sections] == ["VAR_INPUT", "VAR"]
    assert block.sections[1].variables == (("_s", "STRING(80)", "'a;//b'", ("// Where", "// it is.")),)
    assert (block.head.comment, block.body) == (("// What it is.",), "xEnable := FALSE;")
    assert block.declaration == BLOCK.partition("\n\n")[0]
    assert [(method.name, method.access, method.returns) for method in block.methods] == [("Work", "PRIVATE", "BOOL")]
    enum, struct, constants = read("E_A", ENUM), read("ST_A", STRUCT), read("GVL_A", LIST)
    assert isinstance(enum, DataType)
    assert (enum.base, enum.initial, [member.value for member in enum.members]) == ("UDINT", "CLOSED", ["0", "1"])
    assert isinstance(struct, DataType)
    assert struct.head.attributes == (Attribute("pack_mode", "8"),)
    assert isinstance(constants, GlobalList)
    assert constants.variables.constant


@pytest.mark.parametrize(
    ("name", "text", "original", "replacement"),
    [
        ("FB_A", BLOCK, "FB_A", "FB_B"),
        ("FB_A", BLOCK, "xEnable : BOOL := TRUE;", "xEnable, xOther : BOOL;"),
        ("FB_A", BLOCK, "xEnable : BOOL := TRUE;", "xEnable : BOOL; xOther : BOOL;"),
        ("FB_A", BLOCK, "// on", "(* on *)"),
        ("FB_A", BLOCK, "VAR_INPUT", "VAR_IN_OUT"),
        ("FB_A", BLOCK, "END_VAR\nVAR", "VAR"),
        ("FB_A", BLOCK, "END_FUNCTION_BLOCK", "END"),
        ("FB_A", BLOCK, "METHOD PRIVATE", "METHOD PROTECTED"),
        ("FB_A", BLOCK, "END_METHOD\n", "END_METHOD\nFUNCTION_BLOCK FB_C\nEND_FUNCTION_BLOCK\n"),
        ("FB_A", BLOCK, "// What it is.", "/* What it is. */"),
        ("E_A", ENUM, ") UDINT", ")"),
        ("E_A", ENUM, "OPEN := 1", "OPEN := 1 + 1"),
        ("E_A", ENUM, "TYPE E_A", "TYPE E_B"),
        ("E_A", ENUM, "{attribute 'strict'}", "{attribute strict}"),
        ("ST_A", STRUCT, "END_TYPE\n", "END_TYPE\nTYPE ST_B : INT; END_TYPE\n"),
        ("ST_A", STRUCT, "a : UINT;", "a : UINT"),
        ("GVL_A", LIST, "END_VAR\n", "END_VAR\nVAR_GLOBAL\nEND_VAR\n"),
        ("GVL_A", LIST, "CONSTANT", "RETAIN"),
    ],
)
def test_reader_rejects_other_styles(name: str, text: str, original: str, replacement: str) -> None:
    assert text.count(original) == 1
    with pytest.raises(NotInStyle):
        read(name, text.replace(original, replacement))


def test_reader_parses_all_templates() -> None:
    for file in (REPOSITORY / "templates" / "st").glob("*.st"):
        assert read(file.stem, file.read_text()).name == file.stem
