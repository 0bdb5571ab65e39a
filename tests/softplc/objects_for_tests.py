"""Types, lists and a block that the tests of the translator use."""

from __future__ import annotations

TYPES = """
{attribute 'qualified_only'}
{attribute 'strict'}
TYPE E_Colour : (RED := 1, GREEN, BLUE := 16#10) UINT := GREEN; END_TYPE

{attribute 'pack_mode' := '1'}
TYPE ST_Packed : STRUCT
    a : BYTE; b : UDINT := 7; c : STRING(2) := 'ab'; d : LREAL := -1.5E+2;
END_STRUCT END_TYPE

{attribute 'pack_mode' := '2'}
TYPE ST_Two : STRUCT a : BYTE; b : UDINT; END_STRUCT END_TYPE

TYPE ST_Natural : STRUCT
    a : BYTE; b : LWORD; c : ST_Packed; e : E_Colour; t : TIME; w : WSTRING(3); p : POINTER TO ST_Packed;
END_STRUCT END_TYPE

FUNCTION_BLOCK FB_Counter
VAR_INPUT
    xUp   : BOOL := TRUE;
    iStep : INT := 1;
END_VAR
VAR_OUTPUT
    iCount : INT;
END_VAR
VAR CONSTANT
    LIMIT_ : INT := 100;
END_VAR
VAR
    _iCalls : INT;
END_VAR
_iCalls := _iCalls + 1;
IF xUp THEN Count(iBy := iStep); ELSE Count(iBy := -iStep); END_IF
END_FUNCTION_BLOCK

METHOD PUBLIC Count : BOOL
VAR_INPUT
    iBy : INT;
    iTimes : INT := 1;
END_VAR
VAR_OUTPUT
    iBefore : INT;
END_VAR
VAR
    iLocal : INT := 5;
END_VAR
iBefore := iCount;
iCount := iCount + iBy * iTimes;
iLocal := iLocal + 1;
Count := iCount > LIMIT_ OR iLocal <> 6;
END_METHOD

METHOD PRIVATE Hidden
END_METHOD
"""
FILES = {
    "types.st": TYPES,
    "GVL_Limits.st": """
{attribute 'qualified_only'}
VAR_GLOBAL CONSTANT
    LEAST : LINT := -9223372036854775807 - 1;
    MOST : ULINT := 18446744073709551615;
    TEXT_ : STRING(8) := 'it$'s $24$41';
    WIDE : WSTRING(3) := "$00E4b";
    SMALL : REAL := 1.0E-07;
END_VAR
""",
    "GVL_Shared.st": """
{attribute 'qualified_only'}
VAR_GLOBAL
    diTotal : DINT := -5;
    fbCounter : FB_Counter;
END_VAR
""",
}


def program(name: str, variables: str, body: str) -> str:
    return f"PROGRAM {name}\nVAR\n{variables.rstrip(';')};\nEND_VAR\n{body}\nEND_PROGRAM\n"
