"""Files that no IDE writes are imported or reported within seconds, and error messages escape control characters."""

from __future__ import annotations

from pathlib import Path

import pytest

from shmgen.core.diagnostics import Report
from shmgen.plc import messages, sources

from ..support.command import run
from ..support.guard import within

MANY = 50_000
SECONDS = 10
"""The limit of CPU time. Each file takes at most 2 s; in quadratic time, a file would take minutes."""


def struct(body: str) -> str:
    return f"TYPE A : STRUCT\n{body}\nEND_STRUCT END_TYPE\n"


def xml(inner: str) -> str:
    return f"<project><types><dataTypes>{inner}</dataTypes></types></project>"


def repeat(text: str, many: int = MANY) -> str:
    return "".join(text.replace("@", str(number)) for number in range(many))


LONG = {
    "line_ends.xml": f"<DUT><Declaration>{chr(10) * 1_000_000}</Declaration></DUT>",
    "comments.st": "(*" * MANY,
    "pragmas.st": "{" * MANY,
    "strings.st": "'$" * MANY,
    "types.st": repeat("TYPE T@ : STRUCT a : INT; END_STRUCT END_TYPE\n", 10_000),
    "one_fault.st": repeat("TYPE T@ : STRUCT a : Missing; END_STRUCT END_TYPE\n", 10_000),
    "chain.st": "".join(
        f"TYPE T{n} EXTENDS T{n + 1} : STRUCT a : T{n + 2}; END_STRUCT END_TYPE\n" for n in range(9999)
    ),
    "members.st": struct(repeat("a@ : INT; (* @ *)")),
    "same_names.st": struct("a : INT;" * MANY),
    "names.st": f"TYPE E : ({repeat('a@, ', 10_000)} z) UDINT; END_TYPE\n"
    + struct(repeat("x@ : ARRAY[0..E.a@] OF BOOL;", 5_000)),
    "constants.st": f"VAR_GLOBAL CONSTANT {repeat('M : INT := @;', 5_000)} END_VAR\n"
    + struct(repeat("x@ : ARRAY[0..M] OF BOOL;", 5_000)),
    "sum.st": struct(f"x : ARRAY[0..{'1+' * MANY}1] OF BOOL;"),
    "brackets.st": struct(f"x : ARRAY[0..{'(' * MANY}1] OF BOOL;"),
    "digits.st": struct(f"x : ARRAY[0..{'9' * 6000}#{'9' * 6000}] OF BOOL;"),
    "dimensions.st": struct(f"x : ARRAY[{'0..9,' * MANY}0..9] OF BOOL;"),
    "arrays.st": struct(f"x : {'ARRAY[0..1] OF ' * MANY} BOOL;"),
    "subrange.st": f"TYPE A : INT({'..' * MANY}; END_TYPE",
    "value.st": struct(f"x : ARRAY[0..9] OF INT := [{'1,' * MANY}1];"),
    "pack.st": f"{{attribute 'pack_mode' := '{'9' * 6000}'}}\n{struct('a : INT;')}",
    "float.st": struct(f"a : REAL := {'9' * 6000}; b : LREAL := 1e999;"),
    "deep.xml": "<a>" * MANY,
    "entities.xml": f'<!DOCTYPE a [<!ENTITY a "{"x" * 1000}"><!ENTITY b "{"&a;" * 1000}">]><a>{"&b;" * 1000}</a>',
    "blanks.xml": xml(f"<dataType name='T'><baseType><string length='{' ' * MANY}9' /></baseType></dataType>"),
}


@pytest.mark.slow
@pytest.mark.parametrize("name", LONG)
def test_long_files_are_read_in_linear_time(name: str, tmp_path: Path) -> None:
    (tmp_path / name).write_text(LONG[name])
    report = Report()
    with within(SECONDS):
        result = messages.messages(sources.read([tmp_path / name], report), "a_msgs", report)
        assert len("\n".join(map(str, report.diagnostics))) < 100_000
    assert all(row.message or row.why for row in result.rows)


@pytest.mark.parametrize(
    ("data", "message"),
    [
        (b"<?xml version='1.0' encoding='utf-7'?><a/>", "unknown encoding"),
        (b"<?xml version='1.0' encoding='shift_jis'?><a/>", "unknown encoding"),
        (b"<?xml version='1.0' encoding='none-such'?><a/>", "unknown encoding"),
        (b"\xff\xfea", "not UTF-16"),
        (xml("<dataType name='9'><baseType><INT/></baseType></dataType>"), "`9` is not a name"),
        (xml("<dataType name='&#x9b;31m'><baseType><INT/></baseType></dataType>"), "`\\u009b31m`"),
        (xml("<dataType name='A'><baseType><derived name='&#x9b;31m'/></baseType></dataType>"), "\\u009b31m"),
        (struct("a : INT := $;") + "TYPE 5 : INT; END_TYPE", "`5` is not a name"),
        ("TYPE E : (a := 70000); END_TYPE", "E.a is 70000, which is out of range for INT"),
        (struct("a : ARRAY[0..²] OF INT;"), "`²` is not declared"),
    ],
)  # fmt: skip
def test_faulty_file_is_reported(data: bytes | str, message: str, tmp_path: Path) -> None:
    file = tmp_path / "plant.xml"
    file.write_bytes(data if isinstance(data, bytes) else data.encode())
    done = run(["import", "plant.xml"], tmp_path)
    assert done.code == 1
    assert message in done.stderr
    assert "SHM901" not in done.stderr
    assert "\x9b" not in done.stderr


def test_name_with_a_line_end_is_refused(tmp_path: Path) -> None:
    variable = "<variable name='a&#10;int32 evil'><type><INT/></type></variable>"
    part = f"<dataType name='A'><baseType><struct>{variable}</struct></baseType></dataType>"
    (tmp_path / "plant.xml").write_text(xml(part + "<dataType name='B'><baseType><INT/></baseType></dataType>"))
    done = run(["import", "plant.xml", "--skip"], tmp_path)
    assert done.stdout.startswith("B  plant_msgs/B, 2 bytes\n")
    assert "plant.xml:1: note[SHM003]: `a\\u000aint32 evil` is not a name" in done.stderr


def test_files_in_utf_16_and_cp1252_are_read(tmp_path: Path) -> None:
    for name, encoding in (("one", "utf-16"), ("two", "cp1252")):
        (tmp_path / f"{name}.st").write_text(
            f"TYPE ST_{name} : STRUCT\n a : INT; // Größe\nEND_STRUCT END_TYPE", encoding
        )
    assert run(["import", ".", "-p", "some_msgs"], tmp_path).code == 0
    assert "int16 a  # Größe\n" in (tmp_path / "msgs/some_msgs/msg/One.msg").read_text()
    assert "int16 a  # Größe\n" in (tmp_path / "msgs/some_msgs/msg/Two.msg").read_text()


@pytest.mark.parametrize(
    ("name", "hint"),
    [
        ("Plant.project", "choose Project > Export PLCopenXML"),
        ("Plant.export", "choose Project > Export PLCopenXML"),
        ("Plant.projectarchive", "choose Project > Export PLCopenXML"),
        ("Plant.plcproj", "give the folder of the TwinCAT project"),
    ],
)
@pytest.mark.parametrize("argument", ["the file", "its folder"])
def test_native_project_files_get_a_hint(name: str, hint: str, argument: str, tmp_path: Path) -> None:
    """Report a .project, which is a ZIP archive, and an .export, whose XML has no readable declarations."""
    (tmp_path / "plant").mkdir()
    (tmp_path / "plant" / name).write_bytes(b"PK\3\4" if name != "Plant.export" else b"<ExportFile>")
    done = run(["import", f"plant/{name}" if argument == "the file" else "plant"], tmp_path)
    assert done.code == 1
    assert f"error[SHM001]: {name} is a file of the IDE's own format\n" in done.stderr
    assert hint in done.stderr
