"""The translator names each construct that it refuses, and an error that would stop a PLC raises Trap."""

from __future__ import annotations

import pytest

from tests.softplc import CompileError, Trap, Unsupported, compile_st
from tests.softplc.objects_for_tests import FILES, program
from tests.softplc.translate import translate

TRAPS = {
    "an index too large": ("a : ARRAY[1..3] OF INT; i : INT := 4;", "a[i] := 1;", "index"),
    "an index too small": ("a : ARRAY[1..3] OF INT; i : INT;", "i := a[i];", "index"),
    "a null pointer": ("p : POINTER TO BYTE;", "p^ := 1;", "null"),
    "a division by zero": ("a : INT; b : INT := 1;", "b := b / a;", "division"),
    "MOD by zero": ("a : INT; b : INT := 1;", "b := b MOD a;", "division"),
}


def test_error_that_stops_a_plc_raises_trap() -> None:
    cases = list(TRAPS.values())
    plc = compile_st({f"T{n}.st": program(f"T{n}", *cases[n][:2]) for n in range(len(cases))})
    for number, (_, _, reason) in enumerate(cases):
        with pytest.raises(Trap, match=reason):
            plc.block(f"T{number}")()


UNSUPPORTED = {
    "UnionTypeDeclaration": "TYPE U : UNION a : INT; b : BYTE; END_UNION END_TYPE",
    "INTERFACE": "INTERFACE I_A\nEND_INTERFACE",
    "PROPERTY": "PROPERTY PUBLIC Value : INT\nEND_PROPERTY",
    "FUNCTION outside": "FUNCTION F_A : INT\nEND_FUNCTION",
    "ACTION": "ACTION Go:\nEND_ACTION",
    "NAMESPACE": "NAMESPACE a\nEND_NAMESPACE",
    "EXTENDS": "FUNCTION_BLOCK FB_A EXTENDS FB_B\nEND_FUNCTION_BLOCK",
    "IMPLEMENTS": "FUNCTION_BLOCK FB_A IMPLEMENTS I_B\nEND_FUNCTION_BLOCK",
    "InputOutputDeclarations": "PROGRAM P VAR_IN_OUT a : INT; END_VAR END_PROGRAM",
    "RETAIN": "PROGRAM P VAR RETAIN a : INT; END_VAR END_PROGRAM",
    "TemporaryVariableDeclarations": "PROGRAM P VAR_TEMP a : INT; END_VAR END_PROGRAM",
    "LocatedVariableDeclarations": "PROGRAM P VAR a AT %IX0.0 : BOOL; END_VAR END_PROGRAM",
    "REFERENCE TO": "PROGRAM P VAR a : REFERENCE TO INT; END_VAR END_PROGRAM",
    "RepeatStatement": "PROGRAM P VAR a : INT; END_VAR REPEAT a := 1; UNTIL a = 1 END_REPEAT END_PROGRAM",
    "FOR with BY": "PROGRAM P VAR a : INT; END_VAR FOR a := 1 TO 9 BY 2 DO ; END_FOR END_PROGRAM",
    "initial values that are repeated": "PROGRAM P VAR a : ARRAY[0..1] OF INT := [2(1)]; END_VAR END_PROGRAM",
    "an array of one dimension": "PROGRAM P VAR a : ARRAY[0..1, 0..1] OF INT := [1, 2]; END_VAR END_PROGRAM",
    "InitializedStructure": "TYPE S : STRUCT a : INT; END_STRUCT END_TYPE "
    "PROGRAM P VAR s : S := (a := 1); END_VAR END_PROGRAM",
    "THIS": "FUNCTION_BLOCK F VAR a : INT; END_VAR a := THIS^.a; END_FUNCTION_BLOCK",
    "the function SQRT": "PROGRAM P VAR a : LREAL; END_VAR a := SQRT(a); END_PROGRAM",
    "without 'qualified_only' and 'strict'": "TYPE E : (A := 0) UINT; END_TYPE",
    "VAR_GLOBAL without": "VAR_GLOBAL a : INT; END_VAR",
    "the attribute 'hide'": "{attribute 'hide'} TYPE S : STRUCT a : INT; END_STRUCT END_TYPE",
    "the pragma {IF": "{IF defined (x)} TYPE S : STRUCT a : INT; END_STRUCT END_TYPE",
    "there is no type NOWHERE": "PROGRAM P VAR a : NOWHERE; END_VAR END_PROGRAM",
    "holds itself": "TYPE S : STRUCT a : S; END_STRUCT END_TYPE",
    "a second S": "TYPE S : STRUCT a : INT; END_STRUCT END_TYPE TYPE s : STRUCT a : INT; END_STRUCT END_TYPE",
    "without a FUNCTION_BLOCK": "METHOD Go\nEND_METHOD",
    "without END_TYPE": "TYPE S : STRUCT a : INT; END_STRUCT",
    "blark cannot read it": "PROGRAM P a := := 1; END_PROGRAM",
    "calls on both sides": "FUNCTION_BLOCK F VAR a : INT; END_VAR a := Go() + Go(); END_FUNCTION_BLOCK "
    "METHOD Go : INT END_METHOD",
    "a parameter without a name": "FUNCTION_BLOCK F VAR a : INT; END_VAR a := Go(1); END_FUNCTION_BLOCK "
    "METHOD Go : INT VAR_INPUT b : INT; END_VAR END_METHOD",
    "called without B": "FUNCTION_BLOCK F VAR a : INT; END_VAR a := Go(); END_FUNCTION_BLOCK "
    "METHOD Go : INT VAR_INPUT b : INT; END_VAR END_METHOD",
    "C as input of GO": "FUNCTION_BLOCK F VAR a : INT; END_VAR a := Go(c := 1); END_FUNCTION_BLOCK "
    "METHOD Go : INT END_METHOD",
    "PRIVATE method": "FUNCTION_BLOCK F END_FUNCTION_BLOCK METHOD PRIVATE Go END_METHOD "
    "PROGRAM P VAR f1 : F; END_VAR f1.Go(); END_PROGRAM",
    "the type DateTime|DATE": "PROGRAM P VAR a : DATE; END_VAR END_PROGRAM",
}


@pytest.mark.parametrize("construct", UNSUPPORTED)
def test_unsupported_construct_is_named(construct: str) -> None:
    with pytest.raises(Unsupported, match=construct):
        translate({"a.st": UNSUPPORTED[construct]})


WRONG = {
    "an undeclared name": ("n : INT;", "n := m;", "v_m"),
    "UDINT into UINT": ("a : UDINT; b : UINT;", "b := a;", "the value could change"),
    "signed into unsigned": ("a : INT; b : UDINT;", "b := a;", "the value could change"),
    "signed against unsigned": ("a : DINT; b : UDINT; x : BOOL;", "x := a < b;", "no common type"),
    "a literal too large": ("b : BYTE;", "b := 256;", "does not fit"),
    "a number as a condition": ("n : INT;", "IF n THEN ; END_IF", "truth"),
    "BOOL into INT": ("x : BOOL; n : INT;", "n := x;", "no implicit conversion"),
    "a number into an enumeration": ("e : E_Colour;", "e := 1;", "no conversion"),
    "a value that an enumeration lacks": ("e : E_Colour;", "e := E_Colour.PINK;", "v_pink"),
    "a constant assigned": ("n : INT;", "GVL_Limits.SMALL := 1.0;", "read-only|discards|const"),
    "a member that is not there": ("s : ST_Packed;", "s.z := 1;", "v_z"),
    "a UDINT for a POINTER TO __UXINT": (
        "u : UDINT; r : RTS_IEC_RESULT; h : RTS_IEC_HANDLE; s : STRING(9);",
        "h := SysSharedMemoryOpen2(s, 0, ADR(u), ADR(r));",
        "Pointer",
    ),
}


@pytest.mark.parametrize("title", WRONG)
@pytest.mark.family("[an undeclared name]", "[a literal too large]")
def test_code_that_codesys_refuses_does_not_compile(title: str) -> None:
    variables, body, message = WRONG[title]
    with pytest.raises(CompileError, match=message):
        compile_st(FILES | {"P.st": program("P", variables, body)})


def test_error_contains_its_position() -> None:
    with pytest.raises(Unsupported, match=r"b\.st:2: INTERFACE"):
        translate({**FILES, "b.st": "\nINTERFACE I\nEND_INTERFACE"})
    with pytest.raises(Unsupported, match=r"FB_A\.GO: RepeatStatement"):
        translate(
            {"a.st": "FUNCTION_BLOCK FB_A END_FUNCTION_BLOCK METHOD Go REPEAT ; UNTIL TRUE END_REPEAT END_METHOD"}
        )
