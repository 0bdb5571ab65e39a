from __future__ import annotations

import keyword

import pytest

from shmgen.core.diagnostics import Report, Span
from shmgen.core.model import Field, FieldType, Layout, Message, Scalar, Schema, Sequence, TypeName, ros_type
from shmgen.targets import naming
from shmgen.targets.c import names as c_names
from shmgen.targets.python import names as python_names
from shmgen.targets.st import names as st_names

from ..support.build import layouts_of

ST, PYTHON, C = st_names.NAMES, python_names.NAMES, c_names.NAMES
POSE = TypeName("geometry_msgs", "msg", "Pose")


@pytest.mark.parametrize(
    ("name", "safe"),
    [
        ("position", "position"),
        ("step", "step_"),
        ("Type", "Type_"),
        ("TRUE", "TRUE_"),
        ("DELETE", "DELETE_"),
        ("udint_to_real", "udint_to_real_"),
        ("to_string", "to_string_"),
        ("to_base", "to_base"),
        ("steps", "steps"),
        ("a__b", "a_b"),
        ("__new", "_new"),
        ("end___if", "end_if_"),
    ],
)
def test_structured_text_member_names(name: str, safe: str) -> None:
    assert st_names.st_member(name) == safe


def test_structured_text_escapes_reserved_words() -> None:
    words = """type time action task function step transition dt array at read_only program configuration resource
        interval priority string bool byte log true false add delete on var end_var and or not xor mod to of by
        real lreal lword ulint usint wstring ltime date tod limit max min sel mux sizeof adr pointer reference
        struct union class method property interface this super null ref_to using namespace persistent retain
        test_and_set end_get end_set"""
    for word in words.split():
        assert st_names.st_member(word) == word + "_"


def test_python_escapes_its_keywords() -> None:
    assert set(keyword.kwlist) <= python_names.PYTHON_RESERVED
    assert [python_names.python_member(name) for name in ("from", "match", "self", "type")] == [
        "from_",
        "match",
        "self_",
        "type",
    ]


def test_c_escapes_keywords_and_macros() -> None:
    assert [c_names.c_member(name) for name in ("default", "linux", "xor", "value")] == [
        "default_",
        "linux_",
        "xor_",
        "value",
    ]


def test_structured_text_names_of_a_message() -> None:
    assert st_names.st_type(POSE) == "ST_geometry_msgs_Pose"
    assert st_names.gvl(POSE) == "GVL_geometry_msgs_Pose"
    assert st_names.block_name(POSE, "Publisher") == "FB_geometry_msgs_Pose_Publisher"
    assert st_names.block_name(POSE, "Subscriber") == "FB_geometry_msgs_Pose_Subscriber"
    assert st_names.st_type(TypeName("std_srvs", "srv", "SetBool_Request")) == "ST_std_srvs_SetBool_Request"
    assert st_names.st_type(TypeName("odd__pkg_", "msg", "_X")) == "ST_odd_pkg_X"


@pytest.mark.parametrize(
    ("name", "stem"),
    [
        ("Pose", "pose"),
        ("JointState", "joint_state"),
        ("Point32", "point32"),
        ("TFMessage", "tf_message"),
        ("UInt8MultiArray", "u_int8_multi_array"),
        ("SetBool_Request", "set_bool_request"),
        ("NavSatFix", "nav_sat_fix"),
        ("CANFrame", "can_frame"),
    ],
)
def test_file_stems(name: str, stem: str) -> None:
    assert naming.file_stem(TypeName("any", "msg", name)) == stem


def message_layout(**fields: FieldType) -> Layout:
    all_fields = tuple(
        Field(name, type_, ros_type(type_), Span("demo.msg", line))
        for line, (name, type_) in enumerate(fields.items(), 1)
    )
    name = TypeName("demo", "msg", "Demo")
    schema = Schema((Message(name, all_fields, (), Span("demo.msg"), "demo.msg", ""),), frozenset({name}))
    return layouts_of(schema)[name]


def codes(layout: Layout, target: naming.Names) -> list[tuple[str, int]]:
    report = Report()
    naming.check({layout.name: layout}, "shm_msgs", (), target, ["key"], report)
    return [(diagnostic.code, diagnostic.span.line) for diagnostic in report.diagnostics]


def test_names_equal_up_to_case_clash_if_case_is_ignored() -> None:
    layout = message_layout(Gain=Scalar.UINT8, gain=Scalar.UINT8)
    assert codes(layout, ST) == [("SHM203", 2)]
    assert codes(layout, PYTHON) == codes(layout, C) == []


def test_escaped_name_clashes_with_an_equal_name() -> None:
    assert codes(message_layout(step_=Scalar.UINT8, step=Scalar.UINT8), ST) == [("SHM203", 2)]
    assert codes(message_layout(a_b=Scalar.UINT8, a__b=Scalar.UINT8), ST) == [("SHM203", 2)]
    assert codes(message_layout(**{"from": Scalar.UINT8, "from_": Scalar.UINT8}), PYTHON) == [("SHM203", 2)]
    assert codes(message_layout(int=Scalar.UINT8, int_=Scalar.UINT8), C) == [("SHM203", 2)]


@pytest.mark.parametrize("target", [ST, PYTHON, C])
def test_field_cannot_use_a_name_that_shmgen_adds(target: naming.Names) -> None:
    tail = Sequence(Scalar.UINT8, 4)
    assert codes(message_layout(tail=tail, tail_count=Scalar.UINT8), target) == [("SHM204", 2)]
    assert codes(message_layout(tail_count=Scalar.UINT8, tail=tail), target) == [("SHM204", 1)]
    assert codes(message_layout(a=Scalar.UINT8, b=Scalar.UINT64, _pad0=Scalar.UINT8), target) == [("SHM204", 3)]
    assert codes(message_layout(a=Scalar.UINT8, b=Scalar.UINT64, _pad9=Scalar.UINT8), target) == []


def test_clash_message_contains_cause_and_solution() -> None:
    report = Report()
    layout = message_layout(step_=Scalar.UINT8, step=Scalar.UINT8)
    naming.check({layout.name: layout}, "shm_msgs", (), ST, ["st", "plcopen"], report)
    (text,) = map(str, report.diagnostics)
    assert "`step_` and `step` become the same name in Structured Text: `step` becomes `step_`" in text
    assert "field: demo/Demo.step\n" in text
    assert 'remove "st" and "plcopen" from `targets`' in text
