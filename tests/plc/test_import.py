"""Data types of a PLC project become messages, and types generated from these messages equal the project's types."""

from __future__ import annotations

import re
from pathlib import Path

import pytest

from shmgen.core.diagnostics import Report
from shmgen.plc import declarations, sources
from tests.softplc import compile_st

from ..support.build import classes
from ..support.command import Result, run
from ..support.plc_demo import ready

TYPES = """\
(* What the press is doing *)
TYPE E_State :
(
    eIdle := 0,   // nothing
    eMoving,      (* on its way *)
    eFault := 16#10
) UINT := eIdle;
END_TYPE

// One axis.
TYPE ST_Axis :
STRUCT
    rPos      : LREAL;              // actual position [mm]
    rSpeeds   : ARRAY[1..3] OF REAL;
    bEnabled  : BOOL := TRUE;
    sName     : STRING(20) := 'axis';
    eState    : E_State;
    tTimeout  : TIME;
    wStatus   : WORD;               // bit 0 ready
    aiGrid    : ARRAY[-1..1, 0..1] OF INT;
END_STRUCT
END_TYPE

TYPE ST_Plant :
STRUCT
    // all of them,
    // in order
    Axes       : ARRAY[1..4] OF ST_Axis;
    x1         : SINT;
    sText      : STRING;
    wsText     : WSTRING(5);
    ltNow      : LTIME;
    asNames    : ARRAY[0..1] OF STRING(7);
    udiCount, udiLast : UDINT;
END_STRUCT
END_TYPE
"""
TOML = """\
path = ["msgs"]
messages = ["plant_msgs"]
[types]
bool = "BOOL"
[[topics]]
topic = "/plant"
type = "plant_msgs/Plant"
direction = "from_plc"
"""
STRICT = "{attribute 'qualified_only'}\n{attribute 'strict'}\nTYPE E_"


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The folder of a project with imported messages and generated files."""
    folder = tmp_path_factory.mktemp("plant")
    (folder / "Plant.st").write_text(TYPES)
    (folder / "shmgen.toml").write_text(TOML)
    result = run(["import", "Plant.st"], folder)
    assert (result.code, result.stderr) == (0, "")
    assert result.stdout.splitlines()[:5] == [
        "E_State   plant_msgs/State, 2 bytes",
        "ST_Axis   plant_msgs/Axis, 64 bytes",
        "ST_Plant  plant_msgs/Plant, 384 bytes",
        "",
        "3 of 3 data types are messages in msgs/plant_msgs",
    ]
    result = run(["generate", "-q"], folder)
    assert (result.code, result.stderr) == (0, "")
    return folder


def read_types(text: str) -> dict[str, object]:
    """Return the kind, base and members of each type, without the padding members that shmgen adds."""
    types, _ = declarations.read(text, "")
    return {
        it.name: (it.kind, it.base, [(m.name, m.type) for m in it.members if not m.name.startswith("_pad")])
        for it in types
    }


def test_messages_keep_comments_units_and_names(folder: Path) -> None:
    assert (folder / "msgs/plant_msgs/msg/State.msg").read_text() == (
        "# What the press is doing\\n# (PLC: E_State : UINT)\\n\\n"
        "uint16 E_IDLE=0  # nothing (PLC: eIdle)\\nuint16 E_MOVING=1  # on its way (PLC: eMoving)\\n"
        "uint16 E_FAULT=16  # (PLC: eFault)\\nuint16 value\\n"
    ).replace("\\n", "\n")
    axis = (folder / "msgs/plant_msgs/msg/Axis.msg").read_text()
    assert "float64 r_pos  # actual position [mm] (PLC: rPos)\n" in axis
    assert "int16[6] ai_grid  # (PLC: aiGrid : ARRAY[-1..1, 0..1] OF INT)\n" in axis
    assert '\nstring<=20 s_name "axis"  # (PLC: sName)\n' in axis
    plant = (folder / "msgs/plant_msgs/msg/Plant.msg").read_text()
    assert "# all of them,\n# in order\nAxis[4] axes  # (PLC: Axes : ARRAY[1..4] OF ST_Axis)\n" in plant
    assert "int8 x1\nstring<=80 s_text  # (PLC: sText)\n" in plant


@pytest.mark.slow
def test_generated_types_have_the_names_and_sizes_of_the_project(folder: Path) -> None:
    """Compare sizes in the soft PLC, which aligns the project's types naturally and packs the generated types."""
    files = {
        path.relative_to(folder / "generated").as_posix(): path for path in (folder / "generated/st").rglob("*.st")
    }
    texts = {name: path.read_text() for name, path in files.items()}
    ours = "".join(text for name, text in texts.items() if re.search(r"/(ST|E)_(?!Shm)\w+\.st", name))
    project_text = TYPES.replace("STRING;", "STRING(80);")
    expected, actual = read_types(project_text), read_types(ours)
    assert actual == {name: (kind, base.partition(" ")[0], members) for name, (kind, base, members) in expected.items()}
    assert "Msg           : ST_Plant;" in texts["st/plant_msgs/FB_plant_msgs_Plant_Publisher.st"]
    program = (
        "FUNCTION_BLOCK FB_Sizes\nVAR_OUTPUT\n    n1, n2, n3 : UDINT;\nEND_VAR\n"
        "VAR\n    a : ST_Axis;\n    p : ST_Plant;\nEND_VAR\n"
        "n1 := SIZEOF(a); n2 := SIZEOF(p); n3 := SIZEOF(a.eState);\nEND_FUNCTION_BLOCK\n"
    )
    sizes = []
    for text in (project_text, ours):
        text = re.sub(r"\nTYPE E_", "\n" + STRICT, "\n" + re.sub(r"eMoving,", "eMoving := 1,", text))
        block = compile_st({"types.st": text, "sizes.st": program}).block("FB_Sizes")
        block()
        sizes.append((block.n1, block.n2, block.n3))
    assert sizes == [(64, 384, 2)] * 2


@pytest.mark.slow
def test_python_reads_samples_of_imported_plc_types(folder: Path, topic: str) -> None:
    from shmgen.core.model import TypeName

    _, _, subscriber = classes(folder / "generated", "shm_msgs", TypeName("plant_msgs", "msg", "Plant"))
    texts = {}
    for path in (folder / "generated/st").rglob("*.st"):
        text = path.read_text()
        texts[path.name] = re.sub(r"\nTYPE E_State", "\n" + STRICT + "State", text)
    plc = compile_st(texts)
    with subscriber(topic) as robot:
        block = plc.block("FB_plant_msgs_Plant_Publisher")
        block.Msg.Axes[1].rSpeeds[2], block.Msg.Axes[4].wStatus = 2.5, 7
        block.Msg.Axes[1].sName, block.Msg.udiLast = "first", 9
        block.xEnable, block.sTopic = True, topic
        assert ready(block).xSent
        read = robot.read()
        assert (read.axes[0].r_speeds[1], read.axes[0].s_name) == (2.5, "first")
        assert (read.axes[3].w_status, read.axes[3].s_name, read.udi_last) == (7, "axis", 9)


def test_names_option_generates_ros_names(folder: Path) -> None:
    (folder / "ros.toml").write_text(TOML.replace("[types]\n", '[types]\nnames = "ros"\n'))
    assert run(["generate", "-q", "-c", "ros.toml", "-o", "ros"], folder).code == 0
    text = (folder / "ros/st/plant_msgs/ST_plant_msgs_Axis.st").read_text()
    assert re.search(r"\n    r_speeds  +: ARRAY\[0\.\.2\] OF REAL;", text)
    assert "(PLC:" not in text


XML = """\
<project xmlns="http://www.plcopen.org/xml/tc6_0200"><types><dataTypes>
  <dataType name="E_Mode"><baseType><enum><values><value name="OFF" /><value name="ON" value="5" /></values></enum>
  </baseType>
  </dataType>
  <dataType name="ST_Part"><baseType><struct>
    <variable name="aValues"><type><array><dimension lower="0" upper="MAX" /><baseType><REAL /></baseType></array>
      </type>
      <documentation><xhtml xmlns="http://www.w3.org/1999/xhtml"> of the part </xhtml></documentation></variable>
    <variable name="eMode"><type><derived name="E_Mode" /></type></variable>
    <variable name="sText"><type><string length="9" /></type></variable>
  </struct></baseType></dataType>
  <dataType name="T_Alias"><baseType><derived name="ST_Part" /></baseType></dataType>
  <dataType name="ST_Text"><baseType><struct /></baseType><addData>
    <data name="http://www.3s-software.com/plcopenxml/interfaceasplaintext"><InterfaceAsPlainText>
      <xhtml xmlns="http://www.w3.org/1999/xhtml">TYPE ST_Text :
STRUCT
  nOne : INT; // of the text
END_STRUCT
END_TYPE</xhtml></InterfaceAsPlainText></data></addData></dataType>
</dataTypes></types><addData><data name="globalvars"><globalVars name="GVL" constant="true">
  <variable name="MAX"><type><INT /></type><initialValue><simpleValue value="3" /></initialValue></variable>
</globalVars></data></addData></project>
"""
TCDUT = """\
<?xml version="1.0" encoding="utf-8"?>
<TcPlcObject Version="1.1.0.1"><DUT Name="ST_Valve" Id="{1}"><Declaration><![CDATA[TYPE ST_Valve EXTENDS ST_Text :
STRUCT
    bOpen : BOOL; // it is
END_STRUCT
END_TYPE
]]></Declaration></DUT></TcPlcObject>
"""


def test_exports_of_codesys_and_twincat_are_imported(tmp_path: Path) -> None:
    (tmp_path / "plc").mkdir()
    (tmp_path / "plc" / "Cell 7.xml").write_text(XML)
    (tmp_path / "plc" / "ST_Valve.TcDUT").write_bytes(b"\xef\xbb\xbf" + TCDUT.replace("\n", "\r\n").encode())
    result = run(["import", "plc", "-p", "cell_msgs"], tmp_path)
    assert (result.code, result.stderr) == (0, "")
    messages = {path.stem: path.read_text() for path in (tmp_path / "msgs/cell_msgs/msg").iterdir()}
    assert messages["Part"].splitlines()[2:] == [
        "float32[4] a_values  # of the part (PLC: aValues)",
        "Mode e_mode  # (PLC: eMode : E_Mode)",
        "string<=9 s_text  # (PLC: sText)",
    ]
    assert "int16 OFF=0\nint16 ON=5\nint16 value\n" in messages["Mode"]
    assert "Part value  # (PLC: value : ST_Part)" in messages["Alias"]
    assert messages["Valve"].splitlines()[2:] == [
        "int16 n_one  # of the text (PLC: nOne)",
        "bool b_open  # it is (PLC: bOpen)",
    ]
    (tmp_path / "shmgen.toml").write_text('path = ["msgs"]\nmessages = ["cell_msgs"]\n')
    result = run(["generate", "-q"], tmp_path)
    assert (result.code, result.stderr) == (0, "")
    alias = (tmp_path / "generated/st/cell_msgs/T_Alias.st").read_text()
    assert alias.endswith("TYPE T_Alias :\n    ST_Part;\nEND_TYPE\n")
    xml = (tmp_path / "generated/plcopen/shmgen.xml").read_text()
    assert '<dataType name="E_Mode">' in xml
    again = sources.read([tmp_path / "generated/plcopen/shmgen.xml"], Report())
    assert {"E_Mode", "ST_Part", "T_Alias", "ST_Text", "ST_Valve"} <= {it.name for it in again.types}


def test_skip_omits_types_without_an_equivalent_in_ros(tmp_path: Path) -> None:
    (tmp_path / "a.st").write_text("TYPE ST_A : STRUCT p : POINTER TO INT; END_STRUCT END_TYPE\n" + TYPES)
    assert run(["import", "a.st"], tmp_path).code == 1
    assert not (tmp_path / "msgs").exists()
    result = run(["import", "a.st", "--skip"], tmp_path)
    assert result.code == 0
    assert "a.st:1:20: note[SHM601]: POINTER TO INT has no equivalent in ROS" in result.stderr
    assert "3 of 4 data types are messages" in result.stdout


def import_st(folder: Path, *arguments: str, **texts: str) -> Result:
    """Run `shmgen import` on a folder with files of Structured Text."""
    (folder / "plc").mkdir()
    for name, text in texts.items():
        (folder / "plc" / f"{name}.st").write_text(text)
    return run(["import", "plc", "-p", "some_msgs", *arguments], folder)


def test_namespaces_of_members_bases_and_bounds_are_accepted(tmp_path: Path) -> None:
    """Accept ABSTRACT as well. TcOpen and TwinCAT.OpenFramework use both."""
    base = "TYPE ABSTRACT ST_Base : STRUCT n : INT; END_STRUCT END_TYPE\nTYPE E_X : (A, Last := 3); END_TYPE\n"
    other = (
        "TYPE ST_Other EXTENDS Lib.ST_Base : STRUCT\n e : Lib.E_X; a : ARRAY[0..Lib.E_X.Last + 1 * 2] OF Lib.ST_Base;\n"
        "END_STRUCT END_TYPE\n"
    )
    result = import_st(tmp_path, a_base=base, b_other=other)
    assert (result.code, result.stderr) == (0, "")
    assert "ST_Other  some_msgs/Other, 16 bytes\n" in result.stdout
    text = (tmp_path / "msgs/some_msgs/msg/Other.msg").read_text()
    assert "X e  # (PLC: e : E_X)\nBase[6] a  # (PLC: a : ARRAY[0..5] OF ST_Base)\n" in text


def test_duplicate_type_is_reported_with_both_positions(tmp_path: Path) -> None:
    one = "TYPE ST_A : STRUCT n : INT; END_STRUCT END_TYPE\nTYPE ST_B : STRUCT a : ST_A; END_STRUCT END_TYPE\n"
    other = "TYPE ST_A : STRUCT n : LINT; END_STRUCT END_TYPE\nTYPE ST_C : INT; END_TYPE\n"
    result = import_st(tmp_path, "--skip", one=one, other=other)
    assert "plc/one.st:1:6: note[SHM201]: ST_A is declared differently in plc/other.st:1\n" in result.stderr
    assert result.stdout.startswith(
        "ST_A  left out: ST_A is declared differently in plc/other.st:1\n"
        "ST_B  left out: it contains ST_A, which is left out\n"
        "ST_C  some_msgs/C, 2 bytes\n"
    )


def test_qualified_constant_comes_from_the_named_list(tmp_path: Path) -> None:
    lists = "".join(
        f'<globalVars name="{name}" constant="true"><variable name="N"><type><INT /></type><initialValue>'
        f'<simpleValue value="{value}" /></initialValue></variable></globalVars>'
        for name, value in (("GVL_A", 4), ("GVL_B", 9))
    )
    (tmp_path / "lists.xml").write_text(f"<project>{lists}</project>")
    for bound, expected in (
        ("GVL_B.N", "bytes"),
        ("Lib.GVL_A.N", "bytes"),
        ("N", "`N` is 4 in "),
        ("GVL_C.N", "not declared"),
    ):
        (tmp_path / "a.st").write_text(f"TYPE A : STRUCT x : ARRAY[1..{bound}] OF BYTE; END_STRUCT END_TYPE\n")
        done = run(["import", "a.st", "lists.xml"], tmp_path)
        assert expected in done.stdout + done.stderr


def test_skip_continues_after_an_unreadable_file(tmp_path: Path) -> None:
    result = import_st(tmp_path, "--skip", bad="TYPE ST_A : STRUCT n INT; END_STRUCT END_TYPE\n", good=TYPES)
    assert result.code == 0
    assert "plc/bad.st:1:25: note[SHM003]: expected :, found `;`\n" in result.stderr
    assert "3 of 3 data types are messages" in result.stdout


def test_missing_type_is_reported_once(tmp_path: Path) -> None:
    result = import_st(tmp_path, a="".join(f"TYPE ST_{n} : STRUCT t : TON; END_STRUCT END_TYPE\n" for n in range(300)))
    assert result.stderr.count("SHM602") == 1
    assert "  also ST_1.t (plc/a.st:2)\n" in result.stderr
    assert "  and 294 places more\n" in result.stderr


def test_unverified_types_are_listed(tmp_path: Path) -> None:
    text = (
        "TYPE ST_A : STRUCT END_STRUCT END_TYPE\n"
        "TYPE ST_B EXTENDS ST_A : STRUCT c : LINT; END_STRUCT END_TYPE\n"
        "TYPE ST_C : STRUCT b : ST_B; END_STRUCT END_TYPE\n"
    )
    assert import_st(tmp_path, a=text).stdout.splitlines()[:6] == [
        "ST_A  some_msgs/A, 1 byte, not verified",
        "ST_B  some_msgs/B, 8 bytes, not verified",
        "ST_C  some_msgs/C, 8 bytes, not verified",
        "",
        "3 of 3 data types are messages in msgs/some_msgs",
        "not verified: the size of an empty structure; compare SIZEOF in the PLC",
    ]


def test_generated_members_have_their_plc_names(tmp_path: Path) -> None:
    text = "TYPE ST_A : STRUCT\n Ref : INT; LDT : INT; s : STRING := GVL.cName; b : BIT_;\nEND_STRUCT END_TYPE\n"
    import_st(tmp_path, a=text + "TYPE BIT_ : INT; END_TYPE\n")
    (tmp_path / "shmgen.toml").write_text('path = ["msgs"]\nmessages = ["some_msgs"]\n')
    assert run(["generate", "-q"], tmp_path).code == 0
    generated = (tmp_path / "generated/st/some_msgs/ST_A.st").read_text()
    assert re.search(r"\n    Ref  +: INT;\s", generated)
    assert re.search(r"\n    LDT  +: INT;\s", generated)
    assert 'VL.cNam"' not in (tmp_path / "msgs/some_msgs/msg/A.msg").read_text()


def test_bit_type_gets_its_own_hint(tmp_path: Path) -> None:
    assert "hint: declare the whole" in import_st(tmp_path, a="TYPE A : STRUCT x : BIT; END_STRUCT END_TYPE\n").stderr


def test_import_does_not_write_through_symlinks(tmp_path: Path) -> None:
    (tmp_path / "elsewhere").mkdir()
    (tmp_path / "msgs/some_msgs").mkdir(parents=True)
    (tmp_path / "msgs/some_msgs/msg").symlink_to(tmp_path / "elsewhere")
    result = import_st(tmp_path, a=TYPES)
    assert (result.code, "SHM007" in result.stderr) == (1, True)
    assert not list((tmp_path / "elsewhere").iterdir())


def test_enumeration_is_refused_as_a_base(tmp_path: Path) -> None:
    text = "TYPE E : (A, B); END_TYPE\nTYPE ST_A EXTENDS Lib.E : STRUCT n : INT; END_STRUCT END_TYPE\n"
    result = import_st(tmp_path, a=text)
    assert (result.code, "ST_A extends Lib.E, which is not a structure" in result.stderr) == (1, True)
