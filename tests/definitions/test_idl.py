"""Test .idl files: they are read like the .msg they were generated from, and each diagnostic has a position."""

from __future__ import annotations

import subprocess
import sys
import time
from importlib.machinery import PathFinder
from importlib.util import find_spec
from pathlib import Path

import pytest

from shmgen.config.entries import Bound, Bounds
from shmgen.core.diagnostics import Report, Span
from shmgen.core.model import (
    Array,
    Clock,
    Constant,
    Field,
    Message,
    Ref,
    Scalar,
    Schema,
    Sequence,
    String,
    TypeName,
    TypeOptions,
)
from shmgen.definitions import Sources, idl, load, open_library, rosidl
from shmgen.definitions.catalogue import Definition
from shmgen.generator import bounds, layout
from tests.definitions import references
from tests.definitions.test_requests import load_folder, names, write
from tests.support.command import run

HAS_ROSIDL = bool(find_spec("rosidl_parser") or PathFinder.find_spec("rosidl_parser", [rosidl.DEBIAN]))
needs_rosidl = pytest.mark.skipif(
    not HAS_ROSIDL, reason="rosidl_parser is missing: pip install --no-deps ros-rosidl-parser"
)


def read(text: str, kind: str = "msg") -> tuple[tuple[Message, ...], list[str]]:
    report = Report()
    messages = idl.parse(Definition(TypeName("a_msgs", kind, "Foo"), "Foo.idl", "here", text), text, report)
    return messages, [str(finding) for finding in report.diagnostics]


def in_struct(members: str, before: str = "") -> str:
    return f"module a_msgs {{\n  module msg {{\n{before}\n    struct Foo {{\n{members}\n    }};\n  }};\n}};\n"


def only_field(member: str, before: str = "") -> Field:
    (message,), findings = read(in_struct(member, before))
    assert not findings
    (field,) = message.fields
    return field


def only_constant(constant: str) -> Constant:
    (message,), findings = read(in_struct("int8 a;", f"module Foo_Constants {{ {constant} }};"))
    assert not findings
    (result,) = message.constants
    return result


POINT = Ref(TypeName("geometry_msgs", "msg", "Point"))
POINTS = "typedef geometry_msgs::msg::Point geometry_msgs__msg__Point;\n"
POINTS += "typedef geometry_msgs__msg__Point geometry_msgs__msg__Point__3[3];"


@needs_rosidl
@pytest.mark.parametrize(
    ("member", "before", "type_"),
    [
        ("boolean x;", "", Scalar.BOOL),
        ("octet x;", "", Scalar.UINT8),
        ("char x;", "", Scalar.UINT8),
        ("wchar x;", "", Scalar.UINT16),
        ("int8 x;", "", Scalar.INT8),
        ("short x;", "", Scalar.INT16),
        ("unsigned short x;", "", Scalar.UINT16),
        ("long x;", "", Scalar.INT32),
        ("unsigned long x;", "", Scalar.UINT32),
        ("long long x;", "", Scalar.INT64),
        ("unsigned long long x;", "", Scalar.UINT64),
        ("uint64 x;", "", Scalar.UINT64),
        ("float x;", "", Scalar.FLOAT32),
        ("double x;", "", Scalar.FLOAT64),
        ("string x;", "", String()),
        ("string<5> x;", "", String(5)),
        ("wstring x;", "", String(wide=True)),
        ("wstring<5> x;", "", String(5, wide=True)),
        ("sequence<double> x;", "", Sequence(Scalar.FLOAT64)),
        ("sequence<double, 12> x;", "", Sequence(Scalar.FLOAT64, 12)),
        ("sequence<string<5>> x;", "", Sequence(String(5))),
        ("sequence<wstring<5>> x;", "", Sequence(String(5, wide=True))),  # an unbounded sequence
        ("sequence<wstring<5>, 7> x;", "", Sequence(String(5, wide=True), 7)),
        ("double x[9];", "", Array(Scalar.FLOAT64, 9)),
        ("double__9 x;", "typedef double double__9[9];", Array(Scalar.FLOAT64, 9)),
        ("many x;", "typedef sequence<long> many;", Sequence(Scalar.INT32)),
        ("geometry_msgs__msg__Point__3 x;", POINTS, Array(POINT, 3)),
        ("geometry_msgs::msg::Point x;", "", POINT),
        ("sequence<geometry_msgs::msg::Point, 2> x;", "", Sequence(POINT, 2)),
        ("builtin_interfaces::msg::Time x;", "", Clock.TIME),
        ("sequence<builtin_interfaces::msg::Duration> x;", "", Sequence(Clock.DURATION)),
    ],
)
def test_types_of_fields(member, before, type_):
    assert only_field(member, before).type == type_


@needs_rosidl
@pytest.mark.parametrize(
    ("member", "default"),
    [
        ("@default (value=TRUE) boolean x;", True),
        ("@default (value=-5) int8 x;", -5),
        ("@default (value=0x1F) int8 x;", 31),
        ("@default (value=017) int8 x;", 15),
        ("@default (7) int8 x;", 7),
        ("@default (value=1e-05) double x;", 1e-05),
        ("@default (value=2.5d) double x;", 2.5),
        ('@default (value="a \\"b\\" \\\\ ; // \\u00e9") string x;', 'a "b" \\ ; // é'),
        ('@default (value=L"a" "b") wstring x;', "ab"),
        ('@default (value="(1, -2)") sequence<long> x;', (1, -2)),
        ('@default (value="(1.5,)") double x[1];', (1.5,)),
        ('@default (value="()") sequence<long> x;', ()),
        ("""@default (value="('a', \\"b, c\\")") sequence<string> x;""", ("a", "b, c")),
        ('@default (value="(True, False)") sequence<boolean> x;', (True, False)),
    ],
)
def test_defaults(member, default):
    assert repr(only_field(member).default) == repr(default)


@needs_rosidl
@pytest.mark.parametrize(
    ("constant", "type_", "value"),
    [
        ("const uint8 A = 255;", Scalar.UINT8, 255),
        ("const long A =\n -5 ;", Scalar.INT32, -5),
        ("const boolean A = FALSE;", Scalar.BOOL, False),
        ("const float A = 1.5;", Scalar.FLOAT32, 1.5),
        ('const string A = "x;" " = y";', String(), "x; = y"),
        ('const wstring<3> A = L"abc";', String(wide=True), "abc"),
        ("const unsigned long A = 0xFFFFFFFF;", Scalar.UINT32, 2**32 - 1),
    ],
)
def test_constants(constant, type_, value):
    parsed = only_constant(constant)
    assert (parsed.type, parsed.value) == (type_, value)


DOCUMENTED = r"""// no annotation
#include "a/b.idl"
#include <a/b*.idl>
module a_msgs { module msg {
  module Foo_Constants {
    @verbatim (language="comment", text="about" " it" "\n" " [m] \x41")
    const int8 MOST = 1; /* struct Other { @ */
  };
  @verbatim (language="comment", text=
    " all:\n   indented")
  struct Foo {
    @verbatim (language="comment", text="how fast [m/s]")
    @default (value=1.5) @key
    double__2  speed;

    @unit (value="rad") @verbatim (language="java", text="no")
    double angle, others[2];
  };
  typedef double double__2[2];
  enum Never { @unit (value="x") ONE, TWO };
}; };
"""


@needs_rosidl
def test_annotations_become_documentation():
    (message,), findings = read(DOCUMENTED.replace("(value=1.5)", '(value="(1, 2)")'))
    assert not findings
    assert message.doc == "all:\n  indented"
    assert message.constants[0].doc == "about it\n [m] A"
    assert [(field.name, field.doc, field.unit, field.default) for field in message.fields] == [
        ("speed", "how fast", "m/s", (1.0, 2.0)),
        ("angle", "", "rad", None),
        ("others", "", "rad", None),
    ]
    assert [field.type for field in message.fields][1:] == [Scalar.FLOAT64, Array(Scalar.FLOAT64, 2)]
    speed = message.fields[0]
    assert (speed.written, speed.span.line, speed.span.column) == ("double__2", 14, 5)
    assert speed.span.at("speed").column == 16


@needs_rosidl
def test_parts_of_services_and_actions():
    struct = "struct {} {{ int8 a; }};"
    for kind, endings in {"srv": ("Request", "Response"), "action": ("Goal", "Result", "Feedback")}.items():
        inside = "".join(struct.format(f"Foo_{ending}") for ending in endings)
        messages, findings = read(f"module a_msgs {{ module {kind} {{ {inside} }}; }};", kind)
        assert not findings
        assert [str(message.name) for message in messages] == [f"a_msgs/{kind}/Foo_{ending}" for ending in endings]
    empty, _ = read(in_struct("uint8 structure_needs_at_least_one_member;"))
    assert empty[0].fields == ()


LONG = "".join(f"int8 field_number_{number};\n" for number in range(3000))


@needs_rosidl
@pytest.mark.parametrize(
    ("text", "expected"),
    [
        (in_struct("int9 x;"), "Foo.idl:5:6: error[SHM004]: unknown type `int9`"),
        (in_struct("int8 x\nint8 y;"), "Foo.idl:6:1: error[SHM003]: rosidl_parser rejects this text"),
        ("module a_msgs { module msg {", "Foo.idl:1:29: error[SHM003]: rosidl_parser rejects the end of the file"),
        ("", "Foo.idl:1:1: error[SHM003]"),
        (in_struct("int8 x;\nint16 x;"), "Foo.idl:6:7: error[SHM201]: `x` is already declared in line 5"),
        (in_struct("long double x;"), "Foo.idl:5:13: error[SHM003]: ROS has no such type"),
        (in_struct("fixed<5, 2> x;"), "SHM003"),
        (in_struct("sequence<sequence<long>> x;"), "Foo.idl:5:26: error[SHM003]: an array has one dimension"),
        (in_struct("long x[2][3];"), "Foo.idl:5:6: error[SHM003]: an array has one dimension"),
        (in_struct("l2 x[2];", "typedef long l2[2];"), "an array has one dimension"),
        (in_struct("sequence<l2> x;", "typedef long l2[2];"), "an array has one dimension"),
        (in_struct("long x[0];"), "Foo.idl:5:6: error[SHM302]"),
        (in_struct("sequence<long, 0> x;"), "error[SHM102]"),
        (in_struct("sequence<long, N> x;"), "error[SHM102]: the bound `N` is not a whole number"),
        (in_struct("sequence<long, 0x10> x;"), "error[SHM102]"),
        (in_struct("sequence<long, -1> x;"), "error[SHM102]"),
        (in_struct("sequence<long, 9999999999> x;"), "error[SHM102]"),
        (in_struct("loop x;", "typedef loop loop;"), "error[SHM004]: unknown type `loop`"),
        (in_struct("@default (value=300) int8 x;"), "Foo.idl:5:27: error[SHM005]: `300` is not in -128..127"),
        (in_struct("@default (value=2) boolean x;"), "Foo.idl:5:28: error[SHM006]"),
        (in_struct('@default (value="(1, 2)") long x[3];'), "error[SHM006]: 2 elements, but the array has 3"),
        (in_struct('@default (value="__import__(1)") sequence<long> x;'), "error[SHM00"),
        (in_struct("@optional int8 x;"), "Foo.idl:5:16: error[SHM003]: an optional field has no fixed offset"),
        (
            in_struct("int8 x;", "module Foo_Constants { const int8 A = 1 + 2; };"),
            "Foo.idl:3:41: error[SHM003]: an expression is",
        ),
        (
            in_struct("int8 x;", "module Foo_Constants { const int8 A = B; };"),
            "Foo.idl:3:35: error[SHM006]: `B` is not a valid int8",
        ),
        (in_struct("int8 x;", "module Foo_Constants { const a::b::C A = 1; };"), "error[SHM006]: a constant must be"),
        (
            in_struct("int8 x;", "struct Bar { int8 y; };"),
            "Foo.idl:3:8: error[SHM003]: unexpected structure `a_msgs::msg::Bar`",
        ),
        (in_struct("int8 x;").replace("a_msgs", "b_msgs"), "unexpected structure `b_msgs::msg::Foo`"),
        ("module a_msgs { module msg { enum E { A }; }; };", "error[SHM003]: the structure `Foo` is missing"),
        (
            in_struct("int8 x;", "union U switch (long) { case 1: long a; };"),
            "Foo.idl:3:1: error[SHM003]: ROS has no union",
        ),
        (in_struct("int8 x;", "interface F { long f(); };"), "Foo.idl:3:1: error[SHM003]: ROS has no interface"),
        (
            in_struct("int8 x; /* never closed"),
            "Foo.idl:5:9: error[SHM003]: the end of this string or comment is missing",
        ),
        (
            in_struct('@unit (value="m) int8 x;'),
            "Foo.idl:5:14: error[SHM003]: the end of this string or comment is missing",
        ),
        (in_struct("@unit (value=5 int8 x;"), "Foo.idl:5:1: error[SHM003]: the closing bracket after this is missing"),
        (in_struct("int8 x;\x07"), "error[SHM003]: control character U+0007"),
        (in_struct(LONG), "characters, but the limit of an .idl file is 16,384"),
    ],
    ids=range(36),
)
def test_faults_are_reported(text, expected):
    _, findings = read(text)
    assert expected in "\n".join(findings)
    assert all("Traceback" not in finding for finding in findings)


@needs_rosidl
@pytest.mark.parametrize(
    "text",
    [
        "/*" * 250_000,
        '"\\' * 250_000,
        '"' * 250_001,
        "@a(" * 160_000,
        "@a " * 160_000 + " " * 10_000,
        "a " * 250_000,
        "module a{" * 800,
        in_struct("sequence<" * 500 + "long" + ">" * 500 + " x;"),
        in_struct("x x;", "".join(f"typedef t{number + 1} t{number};" for number in range(500))),
        "(" * 500_000,
        "\n" * 500_000,
        '#include "' * 50_000,
        "1" * 15_000 + "+",
    ],
    ids=range(13),
)
@pytest.mark.family("[0]", "[1]")
def test_long_input_is_rejected_quickly(text):
    start = time.process_time()
    _, findings = read(text)
    assert len(findings) == 1
    assert len(findings[0]) < 2000
    assert time.process_time() - start < 10


@needs_rosidl
def test_msg_takes_precedence_over_its_idl(tmp_path):
    write(
        tmp_path,
        {
            "x_msgs/msg/A.msg": "int8 from_msg",
            "x_msgs/msg/A.idl": "nothing of it is read",
            "x_msgs/msg/B.idl": "module x_msgs { module msg { struct B { x_msgs::msg::A a; }; }; };",
            "x_msgs/srv/S.idl": "module x_msgs { module srv {"
            "struct S_Request { int8 a; }; struct S_Response { int8 b; }; }; };",
        },
    )
    assert names(load_folder(tmp_path, "x_msgs/B")) == ["x_msgs/msg/A", "x_msgs/msg/B"]
    files = [str(tmp_path / "x_msgs/srv/S.idl"), str(tmp_path / "x_msgs/msg/B.idl")]
    by_path = load(open_library(Sources(), Report()), files, Report())
    parts = [f"x_msgs/srv/S_{part}" for part in ("Request", "Response", "Reply")]
    assert names(by_path) == [*parts, "x_msgs/msg/A", "x_msgs/msg/B"]


@needs_rosidl
def test_hint_uses_idl_syntax(tmp_path):
    typedef = "typedef sequence<long> many;"
    text = f"module x_msgs {{ module msg {{ {typedef} struct B {{\n  sequence<double> data;\n many more; }}; }}; }};"
    write(tmp_path, {"x_msgs/msg/B.idl": text})
    output = run(["show", "-I", ".", "x_msgs/B"], tmp_path).stderr.split("\n")
    assert output[0] == "x_msgs/msg/B.idl:2:3: error[SHM101]: unbounded sequence has no fixed size"
    assert output[1:3] == ["    2 |   sequence<double> data;", "      |   ^^^^^^^^^^^^^^^^"]
    assert "  hint: write `sequence<double, N> data`, or set" in output[4]
    assert '  hint: set "x_msgs/B.more" = N' in output[-2]


def load_both(corpus: Path, folder: Path, packages: list[str]) -> tuple[Schema, Schema]:
    """Return the schemas of the corpus, and of the .idl files that rosidl_adapter generates into `folder`."""
    python = references.interpreter("by_rosidl.py")
    assert python
    all_packages = sorted(package.name for package in (corpus / "jazzy").iterdir())
    script = Path(__file__).with_name("idl_of.py")
    subprocess.run(
        [python, "-W", "ignore", str(script), str(corpus / "jazzy"), str(folder), *all_packages],
        check=True,
        capture_output=True,
    )
    for file in (corpus / "jazzy").glob("*/*/*.idl"):
        write(folder, {str(file.relative_to(corpus / "jazzy")): file.read_text()})
    # It uses BasicTypes, which ROS copies from test_interface_files at build time; the corpus lacks BasicTypes.
    unusable = [name for name in ("test_msgs/action/NestedMessage",) if "test_msgs" in packages]
    requests = [
        f"{package}/{file.parent.name}/{file.stem}"
        for package in packages
        for file in sorted((folder / package).glob("*/*.idl"))
    ]
    requests = [request for request in requests if request not in unusable]
    theirs = load(open_library(Sources((folder,)), Report()), requests, Report())
    assert all(message.origin.endswith(".idl") for message in theirs.messages)
    return load(open_library(Sources((corpus / "jazzy",)), Report()), requests, Report()), theirs


# rosidl_adapter reads any text in brackets as a unit; shmgen leaves text such as `[0.0-1.0]` in the comment.
ADAPTER_UNITS = {
    "px4_msgs/SatelliteInfo.svid",
    "px4_msgs/TecsStatus.fast_descend_ratio",
    "sensor_msgs/CompressedImage.format",
    "sensor_msgs/LaserScan.intensities",
    "sensor_msgs/MultiEchoLaserScan.intensities",
    "visualization_msgs/ImageMarker.fill_color",
    "visualization_msgs/Marker.color",
    "visualization_msgs/Marker.texture_resource",
    "visualization_msgs/Marker.uv_coordinates",
}
PX4 = "px4_msgs"


@pytest.mark.sample("[others")
@needs_rosidl
@pytest.mark.skipif(references.interpreter("by_rosidl.py") is None, reason="rosidl_adapter is missing")
@pytest.mark.parametrize(("part", "minimum", "documented"), [("px4_msgs", 227, 0.98), ("others", 400, 0.96)])
def test_generated_idl_equals_its_definition(corpus, tmp_path, part, minimum, documented):
    """Compare fields, types, bounds, defaults, constants, digests and most comments of the whole corpus."""
    others = sorted(package.name for package in (corpus / "jazzy").iterdir() if package.name != PX4)
    ours, theirs = load_both(corpus, tmp_path, [PX4] if part == PX4 else others)
    assert len(ours.messages) >= minimum
    assert [message.name for message in ours.messages] == [message.name for message in theirs.messages]
    units, docs = set(), []
    for own, peer in zip(ours.messages, theirs.messages, strict=True):
        assert len(own.fields) == len(peer.fields)
        for one, other in zip(own.fields, peer.fields, strict=True):
            assert (one.name, one.type, repr(one.default)) == (other.name, other.type, repr(other.default)), own.name
            units |= {f"{own.name.short}.{one.name}"} if one.unit != other.unit else set()
            docs.append(one.doc == other.doc)
        for one, other in zip(own.constants, peer.constants, strict=True):
            assert (one.name, one.type, repr(one.value)) == (other.name, other.type, repr(other.value)), own.name
            docs.append(one.doc == other.doc)
    assert units == {name for name in ADAPTER_UNITS if name.startswith(PX4) == (part == PX4)}
    assert sum(docs) / len(docs) > documented
    assert digests(ours) == digests(theirs)


def digests(schema: Schema) -> dict[TypeName, int]:
    many_bounds = Bounds({}, {message.name.package: Bound(4, Span("")) for message in schema.messages})
    bounded = bounds.apply(schema, many_bounds, Report())
    return {name: entry.digest for name, entry in layout.lay_out(bounded, TypeOptions(), 2**40, Report()).items()}


def test_missing_rosidl_parser_is_reported(monkeypatch):
    monkeypatch.setattr(rosidl, "DEBIAN", "/nowhere")
    monkeypatch.setattr(rosidl, "find_spec", lambda name: None)
    monkeypatch.setitem(sys.modules, "rosidl_parser.parser", None)
    messages, (fault,) = read(in_struct("int8 x;"))
    assert messages == ()
    assert f"Foo.idl: error[SHM008]: rosidl_parser, which reads .idl files, cannot be loaded in {sys.prefix}" in fault
    assert "apt install python3-rosidl" in fault
