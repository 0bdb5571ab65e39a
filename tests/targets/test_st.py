from __future__ import annotations

import itertools
import re
from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Any

import pytest

from shmgen import definitions
from shmgen.config.entries import Bounds
from shmgen.core.diagnostics import Rejected, Report
from shmgen.core.model import Layout, Layouts, Scalar, String, TypeName, TypeOptions
from shmgen.generator import bounds, layout
from shmgen.targets import naming
from shmgen.targets.st.names import NAMES
from shmgen.targets.st.text import ascii_text, comment_lines, literal

from ..conftest import REPOSITORY
from ..support import build, import_or_skip

blark = import_or_skip("blark")

MESSAGES = {
    "Point": "# Where, in `(x, y, z)`.\nfloat64 x  # [m]\nfloat64 y\nfloat64 z\n",
    "Tagged": "uint8 CAR=1\nuint8 TRUCK=2\nstring GREETING='it is $5 (* or // more'\nint64 LEAST=-9223372036854775808\n"
    "float32 SMALL=1e-7\nPoint where\nstring<=10 name 'none'\nbool on true\nint16 level -3\n",
    "Everything": "bool flag\nint8 a\nint16 b\nuint16 c\nint32 d\nuint32 e\nint64 f\nuint64 g\nfloat32 h\nfloat64 i\n"
    "string text\nwstring<=5 wide\nstring<=7[3] names\nPoint[2] corners\nTagged[<=4] tags\nuint8[<=3] blob\n"
    "builtin_interfaces/Time stamp\nbuiltin_interfaces/Duration wait\nfloat64[2] pair [1.5, 2.5]\n",
    "Empty": "",
    "Reserved": "uint8 type\nuint8 time\nuint8 action\nuint8 task\nuint8 function\nuint8 step\nuint8 transition\n"
    "uint8 dt\nuint8 array\nuint8 at\nuint8 read_only\nuint8 program\nuint8 by\nuint8 end_if\nuint8 r\nuint8 x\n"
    "uint8 ADD=1\nuint8 DELETE=2\nuint8 ON=3\nuint8 TRUE=4\n",
}
DEMO = {name: TypeName("demo_msgs", "msg", name) for name in MESSAGES}

SIZES = {
    **dict.fromkeys(("BOOL", "BYTE", "SINT", "USINT"), 1),
    **dict.fromkeys(("INT", "UINT"), 2),
    **dict.fromkeys(("DINT", "UDINT", "REAL", "TIME", "DWORD"), 4),
    **dict.fromkeys(("LINT", "ULINT", "LREAL", "LTIME", "LWORD"), 8),
}


def lay_out(
    folder: Path, messages: Mapping[str, str], options: TypeOptions | None = None, source: str = "jazzy"
) -> Layouts:
    for name, text in messages.items():
        package, _, message = name.rpartition("/")
        file = folder / (package or "demo_msgs") / "msg" / f"{message}.msg"
        file.parent.mkdir(parents=True, exist_ok=True)
        file.write_text(text, encoding="utf-8")
    packages = sorted({name.rpartition("/")[0] or "demo_msgs" for name in messages})
    library = definitions.open_library(definitions.Sources((folder,), source, folder), Report())
    schema = bounds.apply(definitions.load(library, packages, Report()), Bounds({}, {}), Report())
    return layout.lay_out(schema, options or TypeOptions(), 2**26, Report())


def texts_of(layouts: Layouts) -> dict[str, str]:
    return build.texts_of(layouts, "st")


def codes_of(layouts: Layouts) -> list[str]:
    report = Report()
    naming.check(layouts, "shm_msgs", (), NAMES, ["st"], report)
    return [diagnostic.code for diagnostic in report.diagnostics]


def parse(text: str) -> list[Any]:
    return list(blark.parse_source_code(text).transform().items)


def members(text: str) -> list[tuple[str, str]]:
    """Return the names and types of a structure or variable list, parsed by blark."""
    (parsed_object,) = parse(text)
    items = parsed_object.declaration.declarations if hasattr(parsed_object, "declaration") else parsed_object.items
    pairs = []
    for item in items:
        names = item.variables if hasattr(item, "variables") else item.spec.variables
        pairs += [(str(getattr(name, "variable", name)), str(item.init)) for name in names]
    return pairs


def size_of(type_: str, structures: Mapping[str, list[tuple[str, str]]]) -> int:
    """Calculate the bytes of a packed type by the rules of CODESYS, without shmgen's own code."""
    type_ = type_.partition(" :=")[0]
    if array := re.fullmatch(r"ARRAY *\[0\.\.(\d+)\] OF (.+)", type_):
        return (int(array[1]) + 1) * size_of(array[2], structures)
    if string := re.fullmatch(r"(W?)STRING\((\d+)\)", type_):
        return (int(string[2]) + 1) * (2 if string[1] else 1)
    if type_ in SIZES:
        return SIZES[type_]
    return sum(size_of(member, structures) for _, member in structures[type_])


@pytest.fixture(scope="module")
def demo(tmp_path_factory: pytest.TempPathFactory) -> Layouts:
    return lay_out(tmp_path_factory.mktemp("demo"), MESSAGES)


@pytest.fixture(scope="module")
def texts(demo: Layouts) -> dict[str, str]:
    return texts_of(demo)


class ParsedFiles(dict[str, list[Any]]):
    """Files that blark parses at the first access, because parsing all files takes longer than most tests."""

    def __init__(self, texts: Mapping[str, str]) -> None:
        super().__init__()
        self.texts = texts

    def __missing__(self, path: str) -> list[Any]:
        self[path] = parse(self.texts[path])
        return self[path]


@pytest.fixture(scope="module")
def parsed_files(texts: dict[str, str]) -> ParsedFiles:
    return ParsedFiles(texts)


def structures_of(texts: Mapping[str, str]) -> dict[str, list[tuple[str, str]]]:
    return {Path(path).stem: members(text) for path, text in texts.items() if Path(path).name.startswith("ST_")}


# --- the files ----------------------------------------------------------------------------------


@pytest.mark.slow
def test_file_contains_the_object_of_its_name(parsed_files: ParsedFiles) -> None:
    for path, items in ((path, parsed_files[path]) for path in parsed_files.texts):
        stem = Path(path).stem
        first, *methods = items
        match stem.partition("_")[0]:
            case "GVL":
                assert type(first).__name__ == "GlobalVariableDeclarations"
            case "FB":
                assert str(first.name) == stem
                assert {type(method).__name__ for method in methods} == {"Method"}
                continue
            case _:
                assert str(first.declaration.name) == stem
        assert not methods, path


def test_only_requested_messages_have_blocks(tmp_path: Path) -> None:
    lay_out(tmp_path, MESSAGES)
    library = definitions.open_library(definitions.Sources((tmp_path,), "jazzy", tmp_path), Report())
    schema = definitions.load(library, ["demo_msgs/Tagged"], Report())
    layouts = layout.lay_out(bounds.apply(schema, Bounds({}, {}), Report()), TypeOptions(), 2**26, Report())
    assert sorted(path for path in texts_of(layouts) if "/demo_msgs/" in path) == [
        "st/demo_msgs/FB_demo_msgs_Tagged_Publisher.st",
        "st/demo_msgs/FB_demo_msgs_Tagged_Subscriber.st",
        "st/demo_msgs/GVL_demo_msgs_Point.st",
        "st/demo_msgs/GVL_demo_msgs_Tagged.st",
        "st/demo_msgs/ST_demo_msgs_Point.st",
        "st/demo_msgs/ST_demo_msgs_Tagged.st",
    ]


def test_text_of_a_structure(texts: dict[str, str], demo: Layouts) -> None:
    digest = demo[DEMO["Tagged"]].digest
    assert texts["st/demo_msgs/ST_demo_msgs_Tagged.st"] == (
        f"// demo_msgs/msg/Tagged: 40 bytes, layout digest 16#{digest:016X}\n"
        "// Generated by shmgen (0BSD: use it freely) from demo_msgs/msg/Tagged.msg; do not edit.\n"
        "{attribute 'pack_mode' := '1'}\n"
        "TYPE ST_demo_msgs_Tagged :\n"
        "STRUCT\n"
        "    where : ST_demo_msgs_Point;\n"
        "    name  : STRING(10) := 'none';\n"
        "    on_   : USINT := 1;\n"
        "    level : INT := -3;\n"
        "    _pad0 : ARRAY[0..1] OF USINT;\n"
        "END_STRUCT\n"
        "END_TYPE\n"
    )


def test_text_of_constants(texts: dict[str, str], demo: Layouts) -> None:
    digest = demo[DEMO["Tagged"]].digest
    assert texts["st/demo_msgs/GVL_demo_msgs_Tagged.st"] == (
        "// GVL_demo_msgs_Tagged: constants of demo_msgs/msg/Tagged\n"
        "// Generated by shmgen (0BSD: use it freely); do not edit.\n"
        "{attribute 'qualified_only'}\n"
        "VAR_GLOBAL CONSTANT\n"
        "    SHM_TYPE_NAME : STRING(20) := 'demo_msgs/msg/Tagged';\n"
        "    SHM_SIZE      : UDINT := 40;                   // size of one message in bytes\n"
        f"    SHM_DIGEST    : LWORD := 16#{digest:016X};  // layout digest\n"
        "\n"
        "    CAR      : USINT := 1;\n"
        "    TRUCK    : USINT := 2;\n"
        "    GREETING : STRING(22) := 'it is $$5 (* or // more';\n"
        "    LEAST    : LINT := -9223372036854775807 - 1;\n"
        "    SMALL    : REAL := 1.0E-07;\n"
        "END_VAR\n"
    )


def test_no_empty_line_without_constants(texts: dict[str, str]) -> None:
    assert "\n\n" not in texts["st/demo_msgs/GVL_demo_msgs_Empty.st"]


# --- bytes --------------------------------------------------------------------------------------------


@pytest.mark.parametrize("options", [TypeOptions(), TypeOptions("BOOL", "LTIME"), TypeOptions("BOOL", "struct")])
@pytest.mark.family("[options0]")
def test_offsets_and_sizes_match_the_layout(tmp_path: Path, options: TypeOptions) -> None:
    layouts = lay_out(tmp_path, MESSAGES, options)
    structures = structures_of({path: text for path, text in texts_of(layouts).items() if "/ST_" in path})
    for name, laid_out in layouts.items():
        fields = structures[f"ST_{name.package}_{name.name}"]
        sizes = [size_of(type_, structures) for _, type_ in fields]
        offsets = [0, *itertools.accumulate(sizes)]
        assert [slot.name for slot in laid_out.slots] == [member.removesuffix("_") for member, _ in fields]
        assert [(slot.offset, slot.size) for slot in laid_out.slots] == list(zip(offsets, sizes, strict=False))
        assert offsets[-1] == laid_out.size


def test_structured_text_types_of_fields(texts: dict[str, str]) -> None:
    fields = dict(members(texts["st/demo_msgs/ST_demo_msgs_Everything.st"]))
    assert {name: type_ for name, type_ in fields.items() if "_pad" not in name} == {
        "flag": "USINT", "a": "SINT", "b": "INT", "c": "UINT", "d": "DINT", "e": "UDINT", "f": "LINT", "g": "ULINT",
        "h": "REAL", "i": "LREAL", "text": "STRING(80)", "wide": "WSTRING(5)", "names": "ARRAY [0..2] OF STRING(7)",
        "corners": "ARRAY [0..1] OF ST_demo_msgs_Point", "tags_count": "UDINT",
        "tags": "ARRAY [0..3] OF ST_demo_msgs_Tagged", "blob_count": "UDINT", "blob": "ARRAY [0..2] OF USINT",
        "stamp": "TIME", "wait": "TIME", "pair": "ARRAY [0..1] OF LREAL := [1.5, 2.5]",
    }  # fmt: skip


def test_structures_are_packed_and_constants_qualified(texts: dict[str, str]) -> None:
    for path, text in texts.items():
        lines = text.splitlines()
        if "/demo_msgs/ST_" in path:
            assert lines[next(n for n, line in enumerate(lines) if line.startswith("TYPE ")) - 1] == (
                "{attribute 'pack_mode' := '1'}"
            )
        if "/GVL_" in path:
            assert "{attribute 'qualified_only'}" in lines


# --- names and clashes --------------------------------------------------------------------------------


def test_reserved_words_get_an_underscore(texts: dict[str, str]) -> None:
    assert [name for name, _ in members(texts["st/demo_msgs/ST_demo_msgs_Reserved.st"])] == [
        "type_", "time_", "action_", "task_", "function_", "step_", "transition_", "dt_", "array_", "at_", "read_only_",
        "program_", "by_", "end_if_", "r_", "x",
    ]  # fmt: skip
    assert [name for name, _ in members(texts["st/demo_msgs/GVL_demo_msgs_Reserved.st"])][3:] == [
        "ADD_", "DELETE_", "ON_", "TRUE_",
    ]  # fmt: skip


@pytest.mark.parametrize(
    ("messages", "codes"),
    [
        ({"A": "uint8 gain\nuint8 Gain\n"}, ["SHM203"]),
        ({"A": "uint8 step\nuint8 step_\n"}, ["SHM203"]),
        ({"A": "uint8 a__b\nuint8 a_b\n"}, ["SHM203"]),
        ({"A": "uint8 X=1\nuint8 x=2\n"}, ["SHM203"]),
        ({"A": "uint8 SHM_SIZE=1\n"}, ["SHM204"]),
        ({"A": "uint8 shm_digest=1\n"}, ["SHM204"]),
        ({"A": "uint8 structure_needs_at_least_one_member\n"}, []),
        ({"A": "uint8 points\nuint8 POINTS=1\n"}, []),
        ({"a_b/C": "uint8 x\n", "a/b_C": "uint8 x\n"}, ["SHM203"]),
        ({"shmgen/Time": "uint8 x\n"}, ["SHM204"]),
    ],
)
def test_clashing_names_are_reported(tmp_path: Path, messages: dict[str, str], codes: list[str]) -> None:
    assert codes_of(lay_out(tmp_path, messages, source="noetic")) == codes


def test_default_longer_than_its_string_is_rejected(tmp_path: Path) -> None:
    with pytest.raises(Rejected) as rejected:
        lay_out(tmp_path, {"A": 'wstring w "\u00e4\U0001f600"\nstring s "\u20ac"\n'}, TypeOptions(encoding="latin-1"))
    assert [diagnostic.code for diagnostic in rejected.value.diagnostics] == ["SHM005"]


# --- comments and literals ----------------------------------------------------------------------------

HOSTILE = [
    "*)",
    "(* open",
    "(*) both",
    "// twice",
    "{{ view.name }} {% if %}",
    "{attribute 'pack_mode' := '8'}",
    "it's $' and \" and '",
    "a: LREAL; END_STRUCT",
    "caf\u00e9 \u2260 \u00bd \u00b5m \u2192 \u00b13\u00b0 \u200b \U0001f916",
    "tab\tand line\u2028separator",
]


@pytest.mark.parametrize("hostile", HOSTILE)
@pytest.mark.family("[// twice]", "[*)]")
def test_comments_stay_comments(tmp_path: Path, hostile: str) -> None:
    doc = f"# {hostile}\n"
    messages = {"A": f"{doc}\n{doc}{doc}uint8 x\nuint8 y  # {hostile}\n{doc}uint8 C=1  # {hostile}\n"}
    texts = texts_of(lay_out(tmp_path, messages))
    for stem in ("ST_demo_msgs_A", "GVL_demo_msgs_A"):
        text = texts[f"st/demo_msgs/{stem}.st"]
        assert text.isascii()
        assert text.replace("\n", "").isprintable()
        assert "(*" not in text
        assert "*)" not in text
        assert [name for name, _ in members(text)] == (
            ["x", "y"] if stem.startswith("ST") else ["SHM_TYPE_NAME", "SHM_SIZE", "SHM_DIGEST", "C"]
        )
        code = re.sub(r"//.*", "", text)
        assert text.count("//") > code.count("//") == 0
        assert "open" not in code
        assert code.count("END_STRUCT") == stem.startswith("ST")


@pytest.mark.parametrize(
    ("text", "ascii"),
    [
        ("m/s\u00b2", "m/s2"),
        ("\u00b13 \u00b0C, 5 \u00b5m", "+/-3 degC, 5 um"),
        ("M\u00fcller, na\u00efve", "Muller, naive"),
        ("a \u2260 b \u2264 c \u2013 d", "a <> b <= c - d"),
        ("\u00bd \u201cx\u201d\u2026", '1/2 "x"...'),
        ("\u03b1 \u6a5f", "<U+03B1> <U+6A5F>"),
        ("(*)", "( * )"),
        ("tab\there", "tab here"),
        ("a\u0338b", "a<U+0338>b"),
    ],
)
def test_text_is_converted_to_ascii(text: str, ascii: str) -> None:
    assert ascii_text(text) == ascii


def test_only_long_comment_lines_are_folded() -> None:
    lines = comment_lines("word " * 40 + "\n\n  indented\n" + "x" * 150)
    assert lines[2:] == ["//", "//   indented", "// " + "x" * 150]
    assert max(map(len, lines[:2])) <= 103


@pytest.mark.parametrize(
    ("value", "type_", "text"),
    [
        (True, Scalar.BOOL, "1"),
        (-128, Scalar.INT8, "-128"),
        (2**64 - 1, Scalar.UINT64, "18446744073709551615"),
        (-(2**63), Scalar.INT64, "-9223372036854775807 - 1"),
        (1.0, Scalar.FLOAT64, "1.0"),
        (-1.5e300, Scalar.FLOAT64, "-1.5E+300"),
        (1e-05, Scalar.FLOAT64, "1.0E-05"),
        (3, Scalar.FLOAT32, "3.0"),
        (float("inf"), Scalar.FLOAT32, None),
        (float("nan"), Scalar.FLOAT64, None),
        ("it's $1", String(), "'it$'s $$1'"),
        ('ä\n"', String(), "'$C3$A4$0A\"'"),
        ('ä\n"\U0001f600', String(wide=True), '"$00E4$000A$"$D83D$DE00"'),
        ("", String(), "''"),
    ],
)
def test_literals(value: Any, type_: Scalar | String, text: str | None) -> None:
    assert literal(value, type_, TypeOptions()) == text


def test_bool_literal_follows_the_configured_type() -> None:
    assert [literal(value, Scalar.BOOL, TypeOptions("BOOL")) for value in (True, False)] == ["TRUE", "FALSE"]


# --- blocks -------------------------------------------------------------------------------------------


def interface(block: Any) -> dict[str, dict[str, str]]:
    """Return {section: {name: type}} of a block."""
    sections: dict[str, dict[str, str]] = {}
    for section in block.declarations:
        names = sections.setdefault(type(section).__name__, {})
        for item in section.items:
            names |= {str(getattr(name, "variable", name)): str(item.init) for name in item.variables}
    return sections


def test_interface_of_publisher_and_subscriber(parsed_files: ParsedFiles) -> None:
    publisher = interface(parsed_files["st/demo_msgs/FB_demo_msgs_Point_Publisher.st"][0])
    subscriber = interface(parsed_files["st/demo_msgs/FB_demo_msgs_Point_Subscriber.st"][0])
    assert publisher["InputDeclarations"] == {
        "xEnable": "BOOL",
        "sTopic": "STRING(80)",
        "xSend": "BOOL := TRUE",
        "Msg": "ST_demo_msgs_Point",
        "udiDepth": "UDINT := 1",
    }
    assert list(publisher["OutputDeclarations"]) == [
        "xSent", "xBusy", "xError", "eErrorID", "udiSequence", "udiLockMisses",
    ]  # fmt: skip
    assert list(subscriber["InputDeclarations"]) == ["xEnable", "sTopic", "tTimeout", "xNewest", "udiDepth"]
    assert subscriber["OutputDeclarations"]["Msg"] == "ST_demo_msgs_Point"
    assert list(subscriber["OutputDeclarations"]) == [
        "xValid", "xNewData", "xBusy", "xError", "eErrorID", "Msg", "udiSequence", "udiMissed", "udiLockMisses",
        "xStale",
    ]  # fmt: skip


@pytest.mark.slow
def test_no_pointer_in_inputs_and_outputs(parsed_files: ParsedFiles) -> None:
    for path, (block, *_) in ((path, parsed_files[path]) for path in parsed_files.texts):
        if "/FB_demo" in path:
            sections = interface(block)
            for section in ("InputDeclarations", "OutputDeclarations"):
                assert not [type_ for type_ in sections[section].values() if "POINTER" in type_ or "REFERENCE" in type_]


def test_block_releases_locks_in_the_same_call(texts: dict[str, str]) -> None:
    """Reject RETURN, because it could leave a block between the lock and its release."""
    for path, text in texts.items():
        code = re.sub(r"//.*", "", text)
        assert "RETURN" not in code
        for side in ("Read", "Write"):
            assert len(re.findall(rf"\.Begin{side}\(", code)) == len(re.findall(rf"\.End{side}\(", code)), path


def test_all_declared_errors_are_used(texts: dict[str, str]) -> None:
    errors = {name for name, _ in re.findall(r"^    (\w+) +:= (\d+)", texts["st/shmgen/E_ShmError.st"], re.MULTILINE)}
    templates = "".join(path.read_text() for path in (REPOSITORY / "templates" / "st").iterdir())
    assert set(re.findall(r"E_ShmError\.(\w+)", templates)) == errors


# --- every file ---------------------------------------------------------------------------------------


def test_files_are_ascii_without_trailing_blanks(texts: dict[str, str]) -> None:
    for path, text in texts.items():
        assert text.isascii(), path
        assert text.endswith("\n"), path
        assert not text.endswith("\n\n"), path
        assert not re.search(r"[\t\r]|[ ]$", text, re.MULTILINE), path


def test_output_is_reproducible(texts: dict[str, str], tmp_path: Path) -> None:
    assert texts_of(lay_out(tmp_path, MESSAGES)) == texts


def test_time_structure_is_generated_only_on_request(tmp_path: Path, texts: dict[str, str]) -> None:
    path = "st/shmgen/ST_shmgen_Time.st"
    assert path not in texts
    text = texts_of(lay_out(tmp_path, MESSAGES, TypeOptions(time="struct")))[path]
    assert members(text) == [("diSec", "DINT"), ("udiNanosec", "UDINT")]
    assert "{attribute 'pack_mode' := '1'}\nTYPE" in text


def digests(layouts: Iterable[Layout]) -> set[str]:
    return {f"16#{laid_out.digest:016X}" for laid_out in layouts}


def test_digests_match_the_layouts(texts: dict[str, str], demo: Layouts) -> None:
    words = {word for path, text in texts.items() if "/GVL_" in path for word in re.findall(r"LWORD := (\S+);", text)}
    assert words == digests(demo.values())


@pytest.mark.slow
def test_blocks_are_usable_from_ladder_diagrams(parsed_files: ParsedFiles, texts: dict[str, str]) -> None:
    """Use only types without pointers and no VAR_IN_OUT, because LD, FBD and CFC have no addresses."""
    plain = re.compile(r"(ARRAY \[0\.\.\d+\] OF )?([A-Z]+(\(\d+\))?|ST_\w+|E_ShmError)( := .+)?")
    for path, (block, *_) in ((path, parsed_files[path]) for path in texts if "/FB_demo_msgs" in path):
        assert not block.extends
        assert not block.implements
        sections = interface(block)
        assert list(sections)[:2] == ["InputDeclarations", "OutputDeclarations"], path
        assert set(sections) <= {"InputDeclarations", "OutputDeclarations", "VariableDeclarations"}, path
        for name, type_ in (sections["InputDeclarations"] | sections["OutputDeclarations"]).items():
            assert plain.fullmatch(type_), f"{path}: {name} : {type_}"
    for name, structure in structures_of({path: text for path, text in texts.items() if "/demo_msgs/" in path}).items():
        assert all(plain.fullmatch(type_) for _, type_ in structure), name


# --- docs ---------------------------------------------------------------------------------------------


def test_page_explains_exactly_the_declared_errors(texts: dict[str, str]) -> None:
    page = (REPOSITORY / "docs" / "codesys.md").read_text()
    section = page.partition("## eErrorID")[2].partition("\n## ")[0]
    documented = re.findall(r"^\| `([A-Z_]+)` \| \S.+ \|$", section, re.MULTILINE)
    (enum,) = parse(texts["st/shmgen/E_ShmError.st"])
    assert documented == [str(value.name) for value in enum.declaration.init.spec.values]


@pytest.mark.slow
def test_page_explains_all_inputs_and_outputs(parsed_files: ParsedFiles) -> None:
    page = (
        (REPOSITORY / "docs" / "structured-text.md")
        .read_text()
        .partition("## The function blocks")[2]
        .partition("\n## ")[0]
    )
    for role, table in zip(("Subscriber", "Publisher"), page.split("| Publisher |"), strict=True):
        sections = interface(parsed_files[f"st/demo_msgs/FB_demo_msgs_Everything_{role}.st"][0])
        for section, word in (("InputDeclarations", "in"), ("OutputDeclarations", "out")):
            rows = re.findall(rf"^\| {word} \| (.+?) \|", table, re.MULTILINE)
            names = [name for row in rows for name in re.findall(r"`(\w+)", row)]
            assert sorted(names) == sorted(sections[section]), f"{role} {word}"
