"""Constructs of Structured Text behave in the stand-in as IEC 61131-3 and the CODESYS help define."""

from __future__ import annotations

import ctypes
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Any, NamedTuple

import pytest

from tests.softplc import Plc, compile_st
from tests.softplc.objects_for_tests import FILES, program

pytestmark = pytest.mark.slow


class Case(NamedTuple):
    """A test program. `variables` are declared, `body` runs once, and `expected` is compared afterwards."""

    variables: str
    body: str
    expected: dict[str, Any]


CASES = {
    "unsigned wraps": Case(
        "u1 : USINT := 250; u2 : UINT := 65535; u4 : UDINT; u8 : ULINT;",
        "u1 := u1 + 10; u2 := u2 + 1; u4 := u4 - 1; u8 := u8 - 1;",
        {"u1": 4, "u2": 0, "u4": 2**32 - 1, "u8": 2**64 - 1},
    ),
    "signed wraps": Case(
        "s1 : SINT := 127; s2 : INT := 32767; s4 : DINT := -2147483647; s8 : LINT;",
        "s1 := s1 + 1; s2 := s2 * 2; s4 := s4 - 2; s8 := GVL_Limits.LEAST; s8 := s8 - 1;",
        {"s1": -128, "s2": -2, "s4": 2**31 - 1, "s8": 2**63 - 1},
    ),
    "an intermediate result wraps in its own width": Case(
        "a : UINT := 40000; b : UINT := 40000; x : BOOL; d : UDINT := 4000000000; y : BOOL;",
        "x := a + b < a; y := d + d < d;",
        {"x": True, "y": True},
    ),
    "a difference survives the wrap": Case(
        "then_ : UDINT := 4294967290; now : UDINT := 6; elapsed : UDINT;", "elapsed := now - then_;", {"elapsed": 12}
    ),
    "operands widen": Case(
        "b : BYTE := 255; u : UDINT; l : LINT := -1; i : INT := -7; lr : LREAL; si : SINT := -2;",
        "u := b; l := l + i; lr := i; i := si;",
        {"u": 255, "l": -8, "lr": -7.0, "i": -2},
    ),
    "precedence": Case(
        "a : DINT; b : BOOL; c : BOOL; d : DINT; e : DINT; f : BOOL; g : DINT",
        "a := 2 + 3 * 4 - 10 / 4; b := TRUE OR FALSE AND FALSE; c := NOT FALSE AND FALSE; d := -3 + 5; "
        "e := 100 / 10 / 5; f := 1 + 1 = 2 AND 5 > 3 XOR FALSE; g := 7 - 4 - 2;",
        {"a": 12, "b": True, "c": False, "d": 2, "e": 2, "f": True, "g": 1},
    ),
    "division truncates": Case(
        "a : INT := -7; q : INT; r : INT; x : LREAL := 7.0;",
        "q := a / 2; r := a MOD 2; x := x / 2.0;",
        {"q": -3, "r": -1, "x": 3.5},
    ),
    "rounding up to a multiple": Case("n : UDINT := 130; m : UDINT;", "m := (16 + n + 63) / 64 * 64;", {"m": 192}),
    "BOOL and word": Case(
        "x : BOOL := TRUE; w : WORD := 16#00FF; b : BYTE := 2#1010; y : BOOL; d : DWORD;",
        "x := NOT x; w := NOT w; b := NOT b AND 16#0F; y := TRUE XOR TRUE; d := 16#F0 OR 16#1; d := d XOR d;",
        {"x": False, "w": 0xFF00, "b": 0b0101, "y": False, "d": 0},
    ),
    "a BOOL of another bit pattern is TRUE": Case(
        "x : BOOL; p : POINTER TO BYTE; same : BOOL; a : BOOL;",
        "p := ADR(x); p^ := 2; same := x = TRUE; a := x AND TRUE;",
        {"same": True, "a": True},
    ),
    "literals": Case(
        "a : UDINT := 16#FFFF_FFFF; b : INT := -16#10; c : BYTE := 2#1111_0000; d : UDINT := 8#17; e : UINT; "
        "r : REAL := 0.5; l : LREAL := 2.5E-3; u : ULINT := 16#8000000000000000;",
        "e := UINT#5 + 1_000;",
        {"a": 2**32 - 1, "b": -16, "c": 0xF0, "d": 15, "e": 1005, "r": 0.5, "l": 0.0025, "u": 2**63},
    ),
    "constants": Case(
        "a : LINT; b : ULINT; c : STRING(20); d : WSTRING(5); e : REAL;",
        "a := GVL_Limits.LEAST; b := gvl_limits.most; c := GVL_Limits.TEXT_; "
        "d := GVL_Limits.WIDE; e := GVL_Limits.SMALL;",
        {"a": -(2**63), "b": 2**64 - 1, "c": "it's $A", "d": "äb", "e": pytest.approx(1e-7)},
    ),
    "case does not matter": Case(
        "xAbc : BOOL; fb : fb_COUNTER;", "XABC := TRUE OR XaBc; FB.COUNT(IBY := 2);", {"xabc": True, "fb.icount": 2}
    ),
    "STRING": Case(
        "a : STRING(3) := 'abcdef'; b : STRING(10); c : STRING; same : BOOL; less : BOOL; empty : BOOL; n : UDINT",
        "b := 'xyz'; b := a; c := '$N$$$''; same := a = b; less := 'ab' < a; empty := c <> ''; n := SIZEOF(c);",
        {"a": "abc", "b": "abc", "c": "\n$'", "same": True, "less": True, "empty": True, "n": 81},
    ),
    "a shorter STRING keeps the bytes behind it": Case(
        "s : STRING(4) := 'abcd'; p : POINTER TO BYTE; last : BYTE; after : BYTE;",
        "s := 'x'; p := ADR(s); after := p[1]; last := p[3];",
        {"s": "x", "after": 0, "last": ord("d")},
    ),
    "WSTRING": Case(
        'w : WSTRING(2) := "a$D83D$DE00"; n : UDINT; same : BOOL;',
        'n := SIZEOF(w); same := w = "a$D83D";',
        {"n": 6, "same": True},
    ),
    "TIME": Case(
        "t : TIME := T#1s500ms; u : TIME := TIME#1h; v : TIME; n : UDINT; later : BOOL; d : TIME := T#1d2h3m4s5ms;",
        "v := t + T#500ms; n := TIME_TO_UDINT(v); later := u > t; v := t - T#2s;",
        {"t": 1500, "u": 3_600_000, "n": 2000, "later": True, "v": 2**32 - 500, "d": 93_784_005},
    ),
    "conversions": Case(
        "a : DINT; b : UINT; c : LREAL; d : DINT; e : DINT; f : BYTE; g : TIME; h : UDINT; i : USINT; j : INT;",
        "a := LREAL_TO_DINT(2.5); d := LREAL_TO_DINT(-2.5); e := REAL_TO_DINT(1.4); b := DINT_TO_UINT(a - 4); "
        "c := INT_TO_LREAL(-3); f := UDINT_TO_BYTE(16#1FF); g := UDINT_TO_TIME(5); h := BOOL_TO_UDINT(TRUE); "
        "i := DWORD_TO_USINT(16#80); j := UINT_TO_INT(65535);",
        {"a": 3, "d": -3, "e": 1, "b": 65535, "c": -3.0, "f": 255, "g": 5, "h": 1, "i": 128, "j": -1},
    ),
    "pack_mode": Case(
        "packed : UDINT; two : UDINT; natural : UDINT; n : ST_Natural;",
        "packed := SIZEOF(ST_Packed); two := SIZEOF(ST_Two); natural := SIZEOF(n);",
        {"packed": 16, "two": 6, "natural": 56 if ctypes.alignment(ctypes.c_double) == 8 else 48},
    ),
    "initial values": Case(
        "s : ST_Natural; a : ARRAY[1..3] OF ST_Packed; e : E_Colour; f : E_Colour := E_Colour.BLUE;",
        "",
        {"s.c.b": 7, "s.c.c": "ab", "s.c.d": -150.0, "s.e": "GREEN", "a.2.b": 7, "e": "GREEN", "f": "BLUE", "s.a": 0},
    ),
    "initial values of arrays": Case(
        "a : ARRAY[1..3] OF REAL := [1.5, -2.0, 3.0E-1]; b : ARRAY[0..2] OF STRING(3) := ['a,]', 'it$'']; "
        "c : ARRAY[0..1] OF LINT := [-9223372036854775807 - 1, -1]; d : ARRAY[0..1] OF BOOL := [TRUE];",
        "",
        {
            "a.1": 1.5,
            "a.2": -2.0,
            "b.0": "a,]",
            "b.1": "it'",
            "b.2": "",
            "c.0": -(2**63),
            "c.1": -1,
            "d.0": True,
            "d.1": False,
        },
    ),
    "structures are copied": Case(
        "a : ST_Packed; b : ST_Packed; p : POINTER TO ST_Packed; c : ST_Packed;",
        "a.b := 9; b := a; a.b := 1; p := ADR(c); p^ := b; p^.a := 4;",
        {"b.b": 9, "c.b": 9, "c.a": 4},
    ),
    "pointers move by bytes and count by elements": Case(
        "a : ARRAY[0..3] OF UINT; p : POINTER TO UINT; q : POINTER TO UINT; pb : POINTER TO BYTE; x : UINT; y : UINT; "
        "same : BOOL; null : BOOL; b : BYTE;",
        "a[1] := 16#1234; a[2] := 7; p := ADR(a); x := p[2]; p := p + 2; y := p^; q := ADR(a[1]); same := p = q; "
        "pb := p; b := pb^; p := p - 2; p[0] := 5; q := 0; null := q = 0 AND p <> 0;",
        {"x": 7, "y": 0x1234, "same": True, "b": 0x34, "a.0": 5, "null": True},
    ),
    "a pointer through a structure": Case(
        "n : ST_Natural; c : ST_Packed; pn : POINTER TO ST_Natural; x : UDINT; p : POINTER TO ST_Packed; "
        "pp : POINTER TO POINTER TO ST_Packed; same : BOOL;",
        "n.p := ADR(c); n.p^.b := 77; pn := ADR(n); x := pn^.p^.b; pp := ADR(n.p); p := pp^; same := p = n.p;",
        {"c.b": 77, "x": 77, "same": True},
    ),
    "arrays": Case(
        "a : ARRAY[-1..1] OF INT; b : ARRAY[0..1, 1..2] OF DINT; c : ARRAY[0..1] OF ST_Packed; "
        "i : INT; n : UDINT; s : ARRAY[0..2] OF STRING(3)",
        "a[-1] := 4; i := 1; a[i] := 5; b[1, 2] := 6; c[i].b := 8; n := SIZEOF(b); s[2] := 'xyz!'; a[i - 1] := a[i];",
        {"a.-1": 4, "a.1": 5, "a.0": 5, "b.1.2": 6, "c.1.b": 8, "c.0.b": 7, "n": 16, "s.2": "xyz"},
    ),
    "enumerations": Case(
        "e : E_Colour; n : INT; size : UDINT; eq : BOOL;",
        "size := SIZEOF(e); eq := e = E_Colour.GREEN; e := E_Colour.BLUE; "
        "CASE e OF E_Colour.RED: n := 1; E_Colour.GREEN, E_Colour.BLUE: n := 2; END_CASE",
        {"e": "BLUE", "n": 2, "size": 2, "eq": True},
    ),
    "CASE": Case(
        "r : ARRAY[0..9] OF INT; i : INT; K : BYTE",
        "FOR i := -2 TO 7 DO CASE i OF -2: r[0] := 1; 0, 1: r[1] := r[1] + 1; "
        "3..5: r[2] := r[2] + 1; ELSE r[3] := r[3] + 1; END_CASE END_FOR",
        {"r.0": 1, "r.1": 2, "r.2": 3, "r.3": 4},
    ),
    "CASE without ELSE": Case("i : INT := 5; n : INT := 3;", "CASE i OF 1: n := 1; 2: ; END_CASE", {"n": 3}),
    "loops": Case(
        "i : INT; n : INT; m : INT; w : INT; none : INT",
        "FOR i := 1 TO 10 DO IF i = 3 THEN CONTINUE; ELSIF i = 6 THEN EXIT; ELSE n := n + i; END_IF END_FOR "
        "FOR m := 5 TO 4 DO none := 1; END_FOR WHILE w < 7 DO w := w + 2; END_WHILE",
        {"n": 1 + 2 + 4 + 5, "i": 6, "none": 0, "w": 8, "m": 5},
    ),
    "the control variable after FOR": Case("i : INT;", "FOR i := 0 TO 3 DO ; END_FOR", {"i": 4}),
    "EXIT in a CASE ends the loop": Case(
        "i : INT;", "FOR i := 0 TO 9 DO CASE i OF 4: EXIT; END_CASE END_FOR", {"i": 4}
    ),
    "RETURN": Case("n : INT;", "n := 1; IF n = 1 THEN RETURN; END_IF n := 2;", {"n": 1}),
    "AND evaluates both, AND_THEN one": Case(
        "p : POINTER TO BYTE; x : BOOL; y : BOOL",
        "x := p <> 0 AND_THEN p^ = 1; y := p = 0 OR_ELSE p^ = 1;",
        {"x": False, "y": True},
    ),
    "blocks": Case(
        "fb : FB_Counter; other : FB_Counter; n : INT; i : INT; over : BOOL; before : INT;",
        "fb(iStep := 5, iCount => n); fb(); fb(xUp := FALSE); FOR i := 1 TO 3 DO other(); END_FOR "
        "over := other.Count(iBy := 98, iBefore => before);",
        {"n": 5, "fb.iCount": 5, "fb._iCalls": 3, "other.iCount": 101, "over": True, "before": 3},
    ),
    "blocks in an array": Case(
        "fbs : ARRAY[1..2] OF FB_Counter; i : INT; n : INT; over : BOOL;",
        "FOR i := 1 TO 2 DO fbs[i](iStep := i); END_FOR over := fbs[2].Count(iBy := 100); n := fbs[2].iCount;",
        {"n": 102, "over": True},
    ),
    "locals of a method are initialized again": Case(
        "fb : FB_Counter; a : BOOL; b : BOOL",
        "a := fb.Count(iBy := 1); b := fb.Count(iBy := 1, iTimes := 2);",
        {"a": False, "b": False, "fb.iCount": 3},
    ),
    "a variable list with blocks and values": Case(
        "n : INT; d : DINT;",
        "GVL_Shared.fbCounter(iStep := 3); GVL_Shared.fbCounter.Count(iBy := 1); n := GVL_Shared.fbCounter.iCount; "
        "d := GVL_Shared.diTotal;",
        {"n": 4, "d": -5},
    ),
    "real numbers": Case(
        "r : REAL := 16777216.0; l : LREAL := 16777216.0; x : BOOL; n : LREAL := -0.5; m : LREAL",
        "r := r + 1.0; l := l + 1.0; x := r < l; m := -n * 2.0;",
        {"r": 16777216.0, "l": 16777217.0, "x": True, "m": 1.0},
    ),
    "comparisons with NaN": Case(
        "l : LREAL := 1.0E308; a : BOOL; b : BOOL; c : BOOL; d : BOOL; e : BOOL;",
        "l := l * 10.0; l := l - l; a := l >= 0.0; b := l <= 0.0; c := l = l; d := l <> l; e := l < 0.0 OR l > 0.0;",
        {"a": False, "b": False, "c": False, "d": True, "e": False},
    ),
    "comments and blanks": Case(
        "(* a comment // *) n : INT; // another (* one", "n (* := 5 *) := 7 ; // n := 8;\n", {"n": 7}
    ),
}


@pytest.fixture(scope="module")
def plc() -> Plc:
    texts = (program(f"P{n}", case.variables, case.body) for n, case in enumerate(CASES.values()))
    return compile_st(FILES | {f"P{n}.st": text for n, text in enumerate(texts)})


@pytest.mark.parametrize("title", CASES)
def test_construct(plc: Plc, title: str) -> None:
    block = plc.block(f"P{list(CASES).index(title)}")()
    assert {path: read_path(block, path) for path in CASES[title].expected} == CASES[title].expected


def test_packed_variables_are_aligned_to_8_bytes() -> None:
    """Place packed variables at multiples of 8, as generated DUTs require. A 32-bit ARM reads no unaligned members."""
    text = program("P", "x : BYTE; a : ST_Packed; y : BYTE; b : ARRAY[0..1] OF ST_Packed;", "y := x;")
    plc = compile_st(FILES | {"P.st": text})
    assert [plc.offsets["P"][name.upper()][0] % 8 for name in ("a", "b")] == [0, 0]


def read_path(view: Any, path: str) -> Any:
    for part in path.split("."):
        view = view[int(part)] if part.lstrip("-").isdigit() else getattr(view, part)
    return view


def test_operand_in_shared_memory_is_read_once() -> None:
    """Read only 0 or 2, and never 1, from a word that another thread changes between 0 and 2."""
    body = """FOR n := 1 TO 1000000 DO
        IF p^ = 1 THEN wrong := wrong + 1; END_IF
        IF t^ = T#1ms THEN wrong := wrong + 1; END_IF
    END_FOR"""
    variables = "p : POINTER TO UDINT; t : POINTER TO TIME; n : UDINT; wrong : UDINT;"
    block = compile_st({"P.st": program("P", variables, body)}).block("P")
    shared = ctypes.c_uint32()
    block.p = block.t = ctypes.addressof(shared)
    with ThreadPoolExecutor(1) as thread:
        future = thread.submit(block)
        while not future.done():
            for value in (0, 2) * 500:
                shared.value = value
    assert block.wrong == 0


def test_two_plcs_in_one_process_share_nothing() -> None:
    text = "{attribute 'qualified_only'} VAR_GLOBAL CONSTANT N : INT := %d; END_VAR"
    one, two = (compile_st({"GVL.st": text % n, "P.st": program("P", "n : INT", "n := GVL.N;")}) for n in (1, 2))
    assert (one.block("P")().n, two.block("P")().n) == (1, 2)


def test_library_stays_in_its_folder(tmp_path: Path) -> None:
    text = program("P", "n : INT", "n := n + 1;")
    compile_st({"P.st": text}, tmp_path)
    block = Plc.load(tmp_path / "plc.so").block("P")
    assert block.run(0, 5) < 1
    assert block.n == 5
