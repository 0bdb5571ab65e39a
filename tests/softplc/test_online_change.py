"""An online change copies members with the same name and type, and calls the methods in the order of CODESYS."""

from __future__ import annotations

import pytest

from tests.softplc import Plc, compile_st, online_change

INNER = """
{{attribute 'pack_mode' := '1'}}
TYPE ST_Inner : STRUCT {} END_STRUCT END_TYPE
{{attribute 'qualified_only'}} {{attribute 'strict'}} TYPE E_Colour : (RED := 0, GREEN := 1) UINT; END_TYPE
FUNCTION_BLOCK FB_Counter VAR_OUTPUT n : UDINT; {} END_VAR n := n + 1; END_FUNCTION_BLOCK
METHOD FB_Exit : BOOL VAR_INPUT bInCopyCode : BOOL; END_VAR n := n + 100; FB_Exit := bInCopyCode; END_METHOD
METHOD FB_Reinit : BOOL n := n + 1000; END_METHOD
"""
OUTER = """
FUNCTION_BLOCK FB_Outer VAR {} END_VAR inner(); END_FUNCTION_BLOCK
METHOD FB_Init : BOOL VAR_INPUT bInitRetains : BOOL; bInCopyCode : BOOL; END_VAR
IF bInCopyCode AND NOT bInitRetains THEN a := 77; made := TRUE; END_IF END_METHOD
"""
BEFORE = "a : UDINT; b : INT := 2; made : BOOL; s : STRING(8); c : E_Colour; v : ARRAY[0..1] OF ST_Inner; "
BEFORE += "l : ARRAY[0..2] OF INT;"
AFTER = "made : BOOL; b : DINT := 3; new : INT := 4; s : STRING(8); c : E_Colour; v : ARRAY[0..1] OF ST_Inner; "
AFTER += "a : UDINT; l : ARRAY[0..3] OF INT;"


def program(inner: str, counter: str, outer: str) -> Plc:
    text = INNER.format(inner, counter) + OUTER.format(f"inner : FB_Counter; {outer}")
    return compile_st({"program.st": text})


@pytest.mark.slow
def test_online_change_copies_members_and_calls_methods() -> None:
    before = program("x : INT; y : INT; w : ARRAY[0..1] OF INT;", "", BEFORE)
    old = before.block("FB_Outer")()
    old.a, old.b, old.s, old.c = 1, 20, "kept", "GREEN"
    for place in (0, 1):
        old.v[place].x, old.v[place].y, old.v[place].w[1] = 30 + place, 40 + place, 50 + place
        old.l[place] = 60
    after = program("y : INT; x : LINT; w : ARRAY[0..1] OF INT;", "m : UDINT := 9;", AFTER)
    new = online_change(old, after)
    assert (new.a, new.made, new.s, new.c) == (1, False, "kept", "GREEN")  # the copy overwrites the values of FB_Init
    assert (new.b, new.new, list(new.l)) == (3, 4, [0] * 4)  # members of another type, or new members
    assert [(one.y, one.x, list(one.w)) for one in new.v] == [(40, 0, [0, 50]), (41, 0, [0, 51])]
    assert (new.inner.n, new.inner.m) == (1101, 9)  # one call, FB_Exit of the old block, FB_Reinit of the new block
    assert new().inner.n == 1102
