"""An import keeps non-ASCII names and comments with markup, and reports mistyped attributes and types."""

from __future__ import annotations

from pathlib import Path

import pytest

from shmgen.core.diagnostics import Report
from shmgen.plc import sources
from shmgen.plc.text import snake

from ..support.command import run

UMLAUTS = """\
TYPE E_Mode : (Maß := 0, Öl := 1, Höhe := 2, Hühe := 3) INT; END_TYPE
TYPE ST_Größe :
STRUCT
  Länge : ARRAY[Öl..Höhe] OF REAL;
  größe : REAL;
  Maß   : E_Mode;
END_STRUCT
END_TYPE
"""


def test_non_ascii_names_are_spelled_out_in_ros_only(tmp_path: Path) -> None:
    (tmp_path / "plant.st").write_text(UMLAUTS.replace("Öl..", "1.."), "utf-8")
    result = run(["import", "plant.st"], tmp_path)
    assert (result.code, result.stderr) == (0, "")
    messages = {path.stem: path.read_text("utf-8") for path in (tmp_path / "msgs/plant_msgs/msg").iterdir()}
    assert "int16 MASS=0  # (PLC: Maß)\nint16 OEL=1  # (PLC: Öl)\nint16 HOEHE=2" in messages["Mode"]
    assert messages["Groesse"].splitlines()[2:] == [
        "float32[2] laenge  # (PLC: Länge : ARRAY[1..2] OF REAL)",
        "float32 groesse  # (PLC: größe)",
        "Mode mass  # (PLC: Maß : E_Mode)",
    ]
    (tmp_path / "shmgen.toml").write_text('path = ["msgs"]\nmessages = ["plant_msgs"]\n')
    result = run(["generate", "-q"], tmp_path)
    assert (result.code, result.stderr) == (0, "")
    text = (tmp_path / "generated/st/plant_msgs/ST_Größe.st").read_text("utf-8")
    assert "    Länge : ARRAY[1..2] OF REAL;\n    größe : REAL;\n    Maß   : E_Mode;\n" in text
    again = sources.read([tmp_path / "generated/plcopen/shmgen.xml"], Report())
    assert {"E_Mode", "ST_Größe"} <= {it.name for it in again.types}


@pytest.mark.parametrize(
    ("name", "expected"),
    [
        ("Länge", "laenge"),
        ("GRÖSSE", "groesse"),
        ("Maß", "mass"),
        ("Élan", "elan"),
        ("速度", "u36895_u24230"),
        ("_Öl", "oel"),
    ],
)
def test_snake_case_spells_out_non_ascii_letters(name: str, expected: str) -> None:
    assert snake(name) == expected


COMMENTS = {
    "a prefix": "<x:p xmlns:x='http://www.w3.org/1999/xhtml'>belt speed</x:p>",
    "no markup": "belt speed",
    "inner markup": "<xhtml xmlns='http://www.w3.org/1999/xhtml'>belt <b>speed</b></xhtml>",
    "two elements": "<xhtml xmlns='http://www.w3.org/1999/xhtml'><p>belt</p> <p>speed</p></xhtml>",
}


@pytest.mark.parametrize("kind", COMMENTS)
def test_xhtml_comment_is_imported(kind: str, tmp_path: Path) -> None:
    variable = f"<variable name='v'><type><LREAL/></type><documentation>{COMMENTS[kind]}</documentation></variable>"
    part = f"<dataType name='ST_Doc'><baseType><struct>{variable}</struct></baseType></dataType>"
    (tmp_path / "plant.xml").write_text(f"<project><types><dataTypes>{part}</dataTypes></types></project>")
    assert run(["import", "plant.xml"], tmp_path).code == 0
    text = (tmp_path / "msgs/plant_msgs/msg/Doc.msg").read_text()
    assert text.endswith("# belt\n# speed\nfloat64 v\n" if kind == "two elements" else "float64 v  # belt speed\n")


PRAGMAS = [
    "'pack mode' := 1",
    "'pack mode' := '1'",
    "'Pack_Mode' := '1'",
    "'pack_mode' := '3'",
    "'pack_mode' := 1",
    "'packmode'",
]


@pytest.mark.parametrize("pragma", PRAGMAS)
def test_mistyped_pack_mode_is_reported(pragma: str, tmp_path: Path) -> None:
    (tmp_path / "plant.st").write_text(
        f"{{attribute {pragma}}}\nTYPE ST_A : STRUCT b : BOOL; v : LREAL; END_STRUCT END_TYPE\n"
    )
    result = run(["import", "plant.st"], tmp_path)
    assert (result.code, result.stdout.splitlines()[0]) == (0, "ST_A  plant_msgs/A, 16 bytes")
    assert f"note[SHM003]: ST_A is not packed: {{attribute {pragma}".rstrip("'") in result.stderr
    assert "hint: write {attribute 'pack_mode' := '1'}" in result.stderr


def test_mistyped_pack_mode_in_xml_is_reported(tmp_path: Path) -> None:
    data = "<data name='x/attributes'><Attribute Name='pack mode' Value='1'/></data>"
    struct = "<baseType><struct><variable name='v'><type><LREAL/></type></variable></struct></baseType>"
    part = f"<dataType name='ST_A'>{struct}<addData>{data}</addData></dataType>"
    (tmp_path / "plant.xml").write_text(f"<project><types><dataTypes>{part}</dataTypes></types></project>")
    assert "{attribute 'pack mode' := '1'} is not a pack_mode" in run(["import", "plant.xml"], tmp_path).stderr


@pytest.mark.parametrize(
    ("typed", "suggestion"),
    [
        ("float64", "LREAL"),
        ("int32", "DINT"),
        ("Float32", "REAL"),
        ("uint8_t", "USINT"),
        ("double", "LREAL"),
        ("boolean", "BOOL"),
        ("ARRAY[0..2] OF uint16", "UINT"),
        ("str", "STRING"),
        ("LREEL", "LREAL"),
        ("ST_Axs", "ST_Axis"),
    ],
)
def test_foreign_or_mistyped_type_gets_a_hint(typed: str, suggestion: str, tmp_path: Path) -> None:
    (tmp_path / "plant.st").write_text(
        f"TYPE ST_Axis : STRUCT v : LREAL; END_STRUCT END_TYPE\nTYPE ST_A : STRUCT v : {typed}; END_STRUCT END_TYPE\n"
    )
    result = run(["import", "plant.st"], tmp_path)
    assert result.code == 1
    assert f"{typed.rpartition(' ')[2]} is not a data type of this project" in result.stderr
    assert f"hint: did you mean {suggestion}?" in result.stderr
