"""Test the result of each line that a user may write: a field, a constant, or a diagnostic and its position."""

from __future__ import annotations

import math

import pytest

from shmgen.core.diagnostics import Report
from shmgen.core.model import Array, Clock, Constant, Field, Message, Ref, Scalar, Sequence, String, TypeName
from shmgen.definitions import catalogue, parser


def read(text: str, dialect: str = "ros2", kind: str = "msg") -> tuple[list[Message], list]:
    report = Report()
    definition = catalogue.Definition(TypeName("demo_msgs", kind, "Foo"), f"Foo.{kind}", "demo", text)
    return list(parser.parse(definition, text, dialect, report)), report.diagnostics


def read_message(text: str, dialect: str = "ros2") -> Message:
    (result,), findings = read(text, dialect)
    assert not findings, [str(finding) for finding in findings]
    return result


def only_field(text: str, dialect: str = "ros2") -> Field:
    (field,) = read_message(text, dialect).fields
    return field


def only_constant(text: str, dialect: str = "ros2") -> Constant:
    (constant,) = read_message(text, dialect).constants
    return constant


HEADER = Ref(TypeName("std_msgs", "msg", "Header"))

TYPES = [
    ("ros2", "bool x", Scalar.BOOL),
    ("ros2", "byte x", Scalar.UINT8),
    ("ros1", "byte x", Scalar.INT8),
    ("ros2", "char x", Scalar.UINT8),
    ("ros1", "char x", Scalar.UINT8),
    ("ros2", "float64 x", Scalar.FLOAT64),
    ("ros2", "string x", String()),
    ("ros2", "string<=10 x", String(10)),
    ("ros2", "wstring x", String(wide=True)),
    ("ros2", "wstring<=8 x", String(8, wide=True)),
    ("ros2", "string<=10[<=5] x", Sequence(String(10), 5)),
    ("ros2", "string<=10[5] x", Array(String(10), 5)),
    ("ros2", "int32[3] x", Array(Scalar.INT32, 3)),
    ("ros2", "int32[010] x", Array(Scalar.INT32, 10)),
    ("ros2", "int32[<=3] x", Sequence(Scalar.INT32, 3)),
    ("ros2", "int32[] x", Sequence(Scalar.INT32)),
    ("ros1", "int32[] x", Sequence(Scalar.INT32)),
    ("ros1", "time x", Clock.TIME),
    ("ros1", "duration[2] x", Array(Clock.DURATION, 2)),
    ("ros2", "builtin_interfaces/Time x", Clock.TIME),
    ("ros2", "builtin_interfaces/msg/Duration[] x", Sequence(Clock.DURATION)),
    ("ros2", "Bar x", Ref(TypeName("demo_msgs", "msg", "Bar"))),
    ("ros2", "geometry_msgs/Pose x", Ref(TypeName("geometry_msgs", "msg", "Pose"))),
    ("ros2", "geometry_msgs/msg/Pose[] x", Sequence(Ref(TypeName("geometry_msgs", "msg", "Pose")))),
    ("ros2", "Header x", Ref(TypeName("demo_msgs", "msg", "Header"))),
    ("ros1", "Header x", HEADER),
    ("ros1", "Header[] x", Sequence(HEADER)),
    ("ros2", "std_msgs/Header x", HEADER),
    ("ros2", "  \t int8 \t x\t", Scalar.INT8),
    ("ros2", "int8 x# comment", Scalar.INT8),
]


@pytest.mark.parametrize(("dialect", "line", "type"), TYPES)
def test_types(dialect, line, type):
    field = only_field(line, dialect)
    assert field.name == "x"
    assert field.type == type
    assert field.written == line.split()[0]
    assert field.default is None


VALUES = [
    ("int32 x 5", 5),
    ("int8 x -128", -128),
    ("uint64 x 18446744073709551615", 2**64 - 1),
    ("int32 x +7", 7),
    ("uint8 x 0x10", 16),
    ("uint8 x 0b101", 5),
    ("uint8 x 0o17", 15),
    ("uint8 x 010", 10),
    ("int8 x -0x80", -128),
    ("bool x TRUE", True),
    ("bool x 0", False),
    ("float32 x 1", 1.0),
    ("float32 x -.5e-3", -0.0005),
    ("float32 x 3.4028235e38", 3.4028235e38),
    ("float64 x -inf", -math.inf),
    ("string x plain words", "plain words"),
    ("string x plain # comment", "plain"),
    ('string x "a # b"  # comment', "a # b"),
    ('string x "a = b"', "a = b"),
    ("string x ''", ""),
    ("string x '\"'", '"'),
    (r"string x 'it\'s'", "it's"),
    (r'string x "a\\b\n\q"', "a\\b\n\\q"),
    ('string x "  "', "  "),
    ('wstring<=3 x "€€€"', "€€€"),
    ("int32[3] x [1, 2,0x3]", (1, 2, 3)),
    ("int32[] x []", ()),
    ("int32[<=3] x [ 1 ]  # one", (1,)),
    ("bool[2] x [true, 0]", (True, False)),
    ("string[] x [\"a,]\", 'b#', c d]", ("a,]", "b#", "c d")),
    ('string[3] x ["", "max value", "min value"]', ("", "max value", "min value")),
]


@pytest.mark.parametrize(("line", "value"), VALUES)
def test_defaults(line, value):
    default = only_field(line).default
    assert default == value
    assert type(default) is type(value)


CONSTANTS = [
    ("ros2", "uint8 X=0x10", 16),
    ("ros2", "uint8 X = 1", 1),
    ("ros2", "uint8 X =1 # one", 1),
    ("ros2", "byte X=255", 255),
    ("ros1", "byte X=-1", -1),
    ("ros2", "float32 PI=3.14", 3.14),
    ("ros2", "bool ON=true", True),
    ("ros2", 'string S="a # = b" # c', "a # = b"),
    ("ros2", "string S=a b # c", "a b"),
    ("ros2", "string S=", ""),
    ("ros1", 'string S= "a" # not a comment ', '"a" # not a comment'),
    ("ros1", "string S=a=b", "a=b"),
    ("ros1", "int32 small = 010", 10),
]


@pytest.mark.parametrize(("dialect", "line", "value"), CONSTANTS)
def test_constants(dialect, line, value):
    constant = only_constant(line, dialect)
    assert constant.value == value
    assert type(constant.value) is type(value)


# dialect, line; code, column and width of the only diagnostic
FAULTS = [
    ("ros2", "int32", "SHM003", 1, 5),
    ("ros2", " int32 =5", "SHM003", 2, 5),
    ("ros2", "int32[3][3] x", "SHM003", 1, 11),
    ("ros2", "int32] x", "SHM003", 1, 6),
    ("ros2", "int32[ 3 ] x", "SHM003", 1, 6),
    ("ros2", "int32[<= 3] x", "SHM003", 1, 8),
    ("ros2", "int32 [3] x", "SHM202", 7, 3),
    ("ros2", "int32 x[3]", "SHM202", 7, 4),
    ("ros2", "a/b/c/D x", "SHM003", 1, 7),
    ("ros2", "../../etc/passwd x", "SHM003", 1, 16),
    ("ros2", "int32 x 5 6", "SHM006", 9, 3),
    ("ros2", 'string x "a" b', "SHM003", 14, 1),
    ("ros2", 'string x "a', "SHM003", 10, 2),
    ("ros2", "@optional", "SHM003", 1, 9),
    ("ros2", "int8 x\x00", "SHM003", 7, 1),
    ("ros2", "int32[] x [1] 2", "SHM003", 15, 1),
    ("ros2", 'string[] x ["a" b]', "SHM003", 17, 1),
    ("ros1", "int32 x 5", "SHM003", 9, 1),
    ("ros2", "int8 x 128", "SHM005", 8, 3),
    ("ros2", "uint8 X=-1", "SHM005", 9, 2),
    ("ros2", "byte X=256", "SHM005", 8, 3),
    ("ros1", "byte X=128", "SHM005", 8, 3),
    ("ros2", "float32 x 3.5e38", "SHM005", 11, 6),
    ("ros2", "float64 x 1e999", "SHM005", 11, 5),
    ("ros2", "uint8 x " + "9" * 5000, "SHM005", 9, 5000),
    ("ros2", 'string<=2 x "abc"', "SHM005", 13, 5),
    ("ros2", 'string<=2 x "é€"', "SHM005", 13, 4),
    ("ros2", 'wstring<=1 x "\U0001f600"', "SHM005", 14, 3),
    ("ros2", "int8[2] x [1, 300]", "SHM005", 15, 3),
    ("ros2", "int8 x 1.5", "SHM006", 8, 3),
    ("ros2", "uint8 X=one", "SHM006", 9, 3),
    ("ros2", "uint8 X=", "SHM006", 9, 0),
    ("ros2", "float32 x 0x10", "SHM006", 11, 4),
    ("ros2", "bool x yes", "SHM006", 8, 3),
    ("ros2", "int8[2] x 1", "SHM006", 11, 1),
    ("ros2", "int8[2] x [1]", "SHM006", 11, 3),
    ("ros2", "int8[<=2] x [1, 2, 3]", "SHM006", 13, 9),
    ("ros2", "int8[] x [1,]", "SHM006", 13, 0),
    ("ros2", "Bar x 1", "SHM006", 7, 1),
    ("ros2", "builtin_interfaces/Time x 0", "SHM006", 27, 1),
    ("ros2", "Bar X=1", "SHM006", 1, 3),
    ("ros2", "int8[] X=1", "SHM006", 1, 6),
    ("ros2", "string<=0 x", "SHM102", 9, 1),
    ("ros2", "string<=-1 x", "SHM102", 9, 2),
    ("ros2", "string<= 5 x", "SHM102", 9, 0),
    ("ros2", "string<=x x", "SHM102", 9, 1),
    ("ros2", "int32[<=0] x", "SHM102", 9, 1),
    ("ros2", "int32[<=] x", "SHM102", 9, 0),
    ("ros2", "int32[-1] x", "SHM102", 7, 2),
    ("ros2", "int32[N] x", "SHM102", 7, 1),
    ("ros2", "int32[4294967296] x", "SHM102", 7, 10),
    ("ros2", "int32[" + "9" * 5000 + "] x", "SHM102", 7, 5000),
    ("ros2", "int32<=5 x", "SHM102", 1, 8),
    ("ros1", "string<=5 x", "SHM102", 1, 9),
    ("ros2", "int32[0] x", "SHM302", 7, 1),
    ("ros1", "int32[0] x", "SHM302", 7, 1),
    ("ros2", "int32 x\nfloat64 y\nint8 x", "SHM201", 6, 1),
    ("ros2", "int32 X=1\nint32 X=1", "SHM201", 7, 1),
    ("ros2", "int32 Xy", "SHM202", 7, 2),
    ("ros2", "int32 x__y", "SHM202", 7, 4),
    ("ros2", "int32 x_", "SHM202", 7, 2),
    ("ros2", "int32 x;", "SHM202", 7, 2),
    ("ros2", "int32 x = 5", "SHM202", 7, 1),
    ("ros1", "int32 1x", "SHM202", 7, 2),
    ("ros2", "int32 größe", "SHM202", 7, 5),
]


@pytest.mark.parametrize(("dialect", "text", "code", "column", "width"), FAULTS)
def test_diagnostic_points_at_the_fault(dialect, text, code, column, width):
    _, (finding,) = read(text, dialect)
    lines = text.split("\n")
    assert (finding.code, finding.span.column, finding.span.width) == (code, column, width), str(finding)
    assert finding.span.line == len(lines)
    assert finding.span.text in (lines[-1], "")
    assert len(str(finding)) < 1000


def test_text_of_a_diagnostic():
    _, (finding,) = read("# heading\nint8 small 300 # too much\n")
    assert str(finding) == (
        "Foo.msg:2:12: error[SHM005]: `300` is not in -128..127, the range of int8\n"
        "    2 | int8 small 300 # too much\n"
        "      |            ^^^\n"
        "  field: demo_msgs/Foo.small"
    )


def test_all_faults_are_reported_up_to_20():
    _, findings = read("int8\nint8 x\nint9000 y 5\nint8 x\n")
    assert [finding.span.line for finding in findings] == [1, 3, 4]
    assert len(read("int8\n" * 1000)[1]) == 20


def test_diagnostics_contain_no_control_characters():
    for text in ("int8 \x1b[2J", "int8 \u202egnp", "int8\x85x"):
        _, findings = read(text)
        assert findings
        assert all(c.isprintable() or c == "\n" for finding in findings for c in str(finding))


def test_ros1_accepts_any_names_but_no_duplicates():
    assert [field.name for field in read_message("float64[9] K\nfloat32 T__\n", "ros1").fields] == ["K", "T__"]
    assert [finding.code for finding in read("int8 A\nint8 A=1", "ros1")[1]] == ["SHM201"]


@pytest.mark.parametrize("end", ["\n", "\r\n", "\r"])
def test_all_line_ends_are_equal(end):
    text = "# About\n\nint8 a\nint8 B=1\n"
    assert read_message(text.replace("\n", end)) == read_message(text)
    assert read_message(text.replace("\n", end)).text == text


def test_empty_message():
    for text in ("", "\n\n", "# only words"):
        assert read_message(text).fields == ()


@pytest.mark.parametrize(
    ("kind", "text", "names"),
    [
        ("srv", "---", ["Foo_Request", "Foo_Response"]),
        ("srv", "int8 a\n--- \t\r\nint8 a", ["Foo_Request", "Foo_Response"]),
        ("srv", "int8 a\n-----  # answer\nint8 a", ["Foo_Request", "Foo_Response"]),
        ("action", "int8 a\n---\n---\n", ["Foo_Goal", "Foo_Result", "Foo_Feedback"]),
    ],
)
def test_parts_of_services_and_actions(kind, text, names):
    messages, findings = read(text, kind=kind)
    assert not findings
    assert [part.name for part in messages] == [TypeName("demo_msgs", kind, name) for name in names]


def test_part_has_its_text_position_and_package():
    (request, response), findings = read("# Ask\nBar a\n---\n# Answer\n\nint8 b\n", kind="srv")
    assert not findings
    assert (request.text, response.text) == ("# Ask\nBar a", "# Answer\n\nint8 b\n")
    assert (request.doc, response.doc) == ("Ask", "Answer")
    assert request.fields[0].type == Ref(TypeName("demo_msgs", "msg", "Bar"))
    assert (request.span.line, response.span.line, response.fields[0].span.line) == (1, 4, 6)


@pytest.mark.parametrize(
    ("kind", "text", "line"),
    [("msg", "int8 a\n---\n", 2), ("srv", "int8 a\n", 2), ("srv", "---\n---\n", 2), ("action", "---", 1)],
)
def test_wrong_number_of_parts_is_rejected(kind, text, line):
    messages, (finding,) = read(text, kind=kind)
    assert (messages, finding.code, finding.span.line) == ([], "SHM003", line)


DOCUMENTED = """\
# A joint.
#   Indented.

# A heading that belongs to nobody

# Where it is [rad]
# for revolute joints
float64 position  # at the stamp
                  # [really]
float64 velocity  # how fast   [m/s]
float64 effort    # [N] or [Nm]
float64[2] range  # [0, 1], and name[i]
uint8 OK=0        # all [well]

uint8 bare
"""


def test_comments_become_documentation():
    message = read_message(DOCUMENTED)
    assert message.doc == "A joint.\n  Indented."
    fields = {field.name: (field.doc, field.unit) for field in message.fields}
    assert fields == {
        "position": ("Where it is [rad]\nfor revolute joints\nat the stamp\n[really]", ""),
        "velocity": ("how fast", "m/s"),
        "effort": ("[N] or [Nm]", ""),
        "range": ("[0, 1], and name[i]", ""),
        "bare": ("", ""),
    }
    assert message.constants[0].doc == "all [well]"


@pytest.mark.parametrize(
    ("text", "message_doc", "field_doc"),
    [
        ("# top\nint8 a", "top", ""),
        ("\n# first, not at the top\nint8 a", "", "first, not at the top"),
        ("\n# about all\n\nint8 a", "about all", ""),
        ("int8 a # behind", "", "behind"),
        ("# all\n\n## one\n#\n# two\nint8 a #", "all", "one\n\ntwo"),
        ("int8 a\n   # indented, below no comment", "", ""),
        ("int8 a # behind\n# above the next\nint8 b", "", "behind"),
    ],
)
def test_comment_belongs_to_message_or_field(text, message_doc, field_doc):
    message = read_message(text)
    assert (message.doc, message.fields[0].doc) == (message_doc, field_doc)


@pytest.mark.parametrize("unit", ["m", "m/s^2", "°C", "%", "kg-m^2", "(meters/second)^2", "deg per second", "-"])
def test_units(unit):
    assert only_field(f"int8 a # about [{unit}] it").unit == unit


def test_unit_may_touch_the_word_before():
    field = only_field("float32 bearing # Bearing angle[rad], from north")
    assert (field.doc, field.unit) == ("Bearing angle, from north", "rad")


@pytest.mark.parametrize(
    "text", ["name[i]", "m[k]", "[3]", "[-1]", "[0, 1]", "[0-1]", "[1..255]", "[A_B]", "[]", "[a b]"]
)
def test_other_brackets_are_not_units(text):
    field = only_field(f"int8 a # {text}")
    assert (field.doc, field.unit) == (text, "")


@pytest.mark.parametrize(
    "text",
    [
        "int8 a" + " " * 200_000 + "[",
        "int8[] a [" + " " * 200_000 + 'x"',
        "int8[] a [" + "1," * 100_000,
        'string a "' + "\\" * 200_000,
        "# " + "[" * 200_000 + "\nint8 a",
        "# " + " " * 200_000 + "[m\nint8 a",
        "int8 " + "a_" * 100_000,
        "int8 " + "A_" * 100_000 + "=1",
        "a/" * 100_000 + " b",
        "<=" * 100_000 + " b",
        "int8 a # x\n" + "  # y\n" * 60_000,
        "#\n" * 200_000 + "int8 a",
        "\n" * 400_000,
    ],
    ids=range(13),
)
@pytest.mark.family("[0]", "[1]", "[2]")
def test_long_input_is_parsed_quickly(text):
    """Parse all inputs within a second. A regular expression that backtracks would need minutes."""
    for dialect in ("ros1", "ros2"):
        read(text, dialect)


def test_positions_of_parts() -> None:
    _, (finding,) = read("bool a\n---\n---  # one too many\nbool b\n", kind="srv")
    assert (finding.code, finding.span.line, finding.span.column, finding.span.width) == ("SHM003", 3, 1, 3)
    (request, response), findings = read("---\nbool b\n", kind="srv")
    assert not findings
    assert [(part.span.line, part.span.column) for part in (request, response)] == [(0, 1), (2, 1)]


def test_byte_keeps_its_word() -> None:
    assert [field.word for field in read_message("byte a\nuint8 b\nchar c\nbyte[2] d\n").fields] == [
        "byte",
        "",
        "",
        "byte",
    ]


def test_hint_about_equals_sign_only_for_defaults() -> None:
    diagnostics = {line: str(read(line)[1][0]) for line in ("int8 speed=1\n", "int8 A__B=1\n", "int8 Speed\n")}
    hint = "write a default without `=`"
    assert {line: hint in text for line, text in diagnostics.items()} == {
        "int8 speed=1\n": True,
        "int8 A__B=1\n": False,
        "int8 Speed\n": False,
    }
