"""The layout of random messages has no gaps, and ctypes and gcc compute the same layout."""

from __future__ import annotations

import ctypes
import itertools
import random
from pathlib import Path

import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from shmgen.core.abi import region_size
from shmgen.core.diagnostics import Rejected, Report, Span
from shmgen.core.model import (
    Array,
    Constant,
    Field,
    Layout,
    Layouts,
    Message,
    Ref,
    Role,
    Scalar,
    Schema,
    Sequence,
    String,
    TypeName,
    TypeOptions,
)
from shmgen.generator.layout import canonical_text, check_size

from .support.build import classes, compile_headers, layouts_of, put, texts_of
from .support.schemas import plain, random_message, schemas

OPTIONS = st.builds(
    TypeOptions,
    bool=st.sampled_from(("USINT", "BOOL")),
    time=st.sampled_from(("TIME", "LTIME", "struct")),
    encoding=st.sampled_from(("utf-8", "latin-1")),
    overflow=st.just("error"),
    names=st.just("plc"),
    own=st.just(()),
)
NUMBER = itertools.count()


def layout_with(*fields: tuple[str, object]) -> Layout:
    span = Span("one.msg")
    name = TypeName("one_msgs", "msg", "One")
    members = tuple(Field(field, type_, "", span) for field, type_ in fields)  # type: ignore[arg-type]
    return layouts_of(Schema((Message(name, members, (), span, "", ""),), frozenset({name})))[name]


@pytest.mark.slow
@given(schemas(), OPTIONS)
def test_slots_cover_the_message_without_gaps(schema: Schema, options: TypeOptions) -> None:
    for layout in layouts_of(schema, options).values():
        end = 0
        for slot in layout.slots:
            assert slot.offset == end
            assert slot.offset % min(slot.align, layout.message.pack) == 0
            end += slot.size
        assert end == layout.size
        assert layout.size % layout.align == 0
        assert layout.size > 0
        assert sum(slot.size for slot in layout.slots if slot.role is Role.PADDING) < 8 * len(layout.slots)


@settings(max_examples=25, suppress_health_check=[HealthCheck.function_scoped_fixture, HealthCheck.too_slow])
@given(schemas(), OPTIONS, st.integers())
def test_ctypes_agrees_and_keeps_values(tmp_path: Path, schema: Schema, options: TypeOptions, seed: int) -> None:
    layouts = layouts_of(schema, options)
    package = f"random{next(NUMBER)}"
    put(texts_of(layouts, "python", package), tmp_path)
    for name, layout in layouts.items():
        kind, _, _ = classes(tmp_path, package, name)
        assert_same_bytes(kind, layout)
        message = random_message(layout, layouts, random.Random(seed))
        assert plain(kind._from_object(message)) == plain(message)
        rebuilt = kind(**{field: getattr(message, field) for field in plain_fields(layout)})
        assert {field: plain(getattr(rebuilt, field)) for field in plain_fields(layout)} == {
            field: plain(getattr(message, field)) for field in plain_fields(layout)
        }


def plain_fields(layout: Layout) -> list[str]:
    """Return the fields that a constructor accepts from foreign objects: all except nested ctypes structures."""
    data = [slot for slot in layout.slots if slot.role is Role.DATA]
    return [slot.name for slot in data if slot.count is not None or not isinstance(slot.type, Ref)]


def assert_same_bytes(kind: type[ctypes.Structure], layout: Layout) -> None:
    assert ctypes.sizeof(kind) == layout.size
    fields = [getattr(kind, entry[0]) for entry in kind._fields_]
    assert [(field.offset, field.size) for field in fields] == [(slot.offset, slot.size) for slot in layout.slots]


@pytest.mark.slow
def test_gcc_has_the_same_layout_of_random_schemas(tmp_path: Path) -> None:
    """Compile many schemas at once: a compiler inside a shrinking loop takes minutes for one failure."""
    examples: list[tuple[Layouts, str]] = []

    @settings(max_examples=40, database=None, derandomize=True)
    @given(schemas(), OPTIONS)
    def collect(schema: Schema, options: TypeOptions) -> None:
        examples.append((layouts_of(schema, options), f"random_c{len(examples)}"))

    collect()
    # All schemas have the same message names, but one translation unit needs different names.
    for layouts, package in examples:
        texts = texts_of(layouts, "c", package)
        put({path: text.replace("random_msgs_", f"{package}_") for path, text in texts.items()}, tmp_path)
    for language in ("c", "c++"):
        compile_headers(tmp_path, language)


def test_pose_has_the_offsets_of_the_paper() -> None:
    from shmgen.config import Config
    from shmgen.generator import pipeline

    layouts = pipeline.lay_out(Config(Path.cwd()), ["geometry_msgs/Pose"])
    layout = layouts[TypeName("geometry_msgs", "msg", "Pose")]
    assert layout.size == 56
    position, orientation = (layouts[name] for name in layout.dependencies)
    assert [slot.offset for slot in layout.slots] == [0, 24]
    assert [slot.offset for slot in position.slots] == [0, 8, 16]
    assert [slot.offset + 24 for slot in orientation.slots] == [24, 32, 40, 48]


def test_iec_types_correct_the_erratum_of_table_1() -> None:
    """Use UINT for 16 bits and UDINT for 32 bits, as in IEC 61131-3. The paper's table exchanges them."""
    assert (Scalar.UINT16.iec, Scalar.UINT16.size) == ("UINT", 2)
    assert (Scalar.UINT32.iec, Scalar.UINT32.size) == ("UDINT", 4)


@pytest.mark.parametrize(
    ("payload", "slots", "size"),
    [(56, 2, 4096), (1, 2, 4096), (944, 2, 4096), (945, 2, 8192), (2**20, 2, 4_198_400), (56, 64, 20480)],
)
def test_region_size_is_a_multiple_of_the_page_size(payload: int, slots: int, size: int) -> None:
    assert region_size(payload, slots) == size


@pytest.mark.parametrize(
    "name",
    [
        TypeName("kartech_linear_actuator_msgs", "msg", "ConfigureOutputsKdFreqDeadbandCmd"),
        TypeName("moveit_task_constructor_msgs", "action", "ExecuteTaskSolution_Feedback"),
        TypeName("longest_msgs", "msg", "N" * (95 - len("longest_msgs/msg/"))),
    ],
)
def test_names_of_real_packages_fit_into_the_header(name: TypeName) -> None:
    assert layouts_of(schema_without_fields(name))[name].name == name


def test_type_name_longer_than_95_bytes_is_rejected() -> None:
    name = TypeName("longest_msgs", "msg", "N" * (96 - len("longest_msgs/msg/")))
    with pytest.raises(Rejected) as rejected:
        layouts_of(schema_without_fields(name))
    (error,) = rejected.value.diagnostics
    assert (error.code, error.message) == ("SHM202", f"{name} has more than 95 bytes, the limit of a type name")


def schema_without_fields(name: TypeName) -> Schema:
    return Schema((Message(name, (), (), Span(f"{name.name}.msg"), "", ""),), frozenset({name}))


def test_region_may_have_exactly_the_largest_size() -> None:
    layout = layout_with(("a", Array(Scalar.UINT8, 5000)))
    size = region_size(layout.size)
    for most, codes in ((size, []), (size - 1, ["SHM303"])):
        report = Report()
        check_size(layout, most, report)
        assert [diagnostic.code for diagnostic in report.diagnostics] == codes


VALUES = [
    (Field("a", Sequence(Scalar.INT8, 3), "", Span("one.msg"), default=(1, 2, 3)), ""),
    (
        Field("a", Sequence(Scalar.INT8, 2), "", Span("one.msg"), default=(1, 2, 3)),
        "the default has 3 elements, but the",
    ),
    (Field("a", String(3), "", Span("one.msg"), default="abc"), ""),
    (Field("a", String(2), "", Span("one.msg"), default="abc"), "'abc' is longer than its bound"),
    (Field("a", String(3), "", Span("one.msg"), default="\N{SNOWMAN}"), "'\N{SNOWMAN}' cannot be written in latin-1"),
    (Constant("A", String(3), "\N{SNOWMAN}", Span("one.msg")), "'\N{SNOWMAN}' cannot be written in latin-1"),
]


@pytest.mark.parametrize(("declared", "reason"), VALUES)
def test_defaults_and_constants_must_fit_their_bounds(declared: Field | Constant, reason: str) -> None:
    name = TypeName("one_msgs", "msg", "One")
    fields = (declared,) if isinstance(declared, Field) else ()
    message = Message(name, fields, () if fields else (declared,), Span("one.msg"), "", "")  # type: ignore[arg-type]
    try:
        layouts_of(Schema((message,), frozenset({name})), TypeOptions(encoding="latin-1"))
        error = ""
    except Rejected as rejected:
        error = rejected.diagnostics[0].message
    assert error.startswith(reason)
    assert bool(error) == bool(reason)


BASE = (("a", Scalar.UINT8), ("b", Scalar.FLOAT64), ("c", String(10)))


@pytest.mark.parametrize(
    "changed",
    [
        (("b", Scalar.FLOAT64), ("a", Scalar.UINT8), ("c", String(10))),
        (("a", Scalar.INT8), ("b", Scalar.FLOAT64), ("c", String(10))),
        (("a", Scalar.UINT8), ("b", Scalar.FLOAT64), ("c", String(11))),
        (("a", Scalar.UINT8), ("b", Scalar.FLOAT64), ("d", String(10))),
        (("a", Scalar.UINT8), ("b", Array(Scalar.FLOAT64, 1)), ("c", String(10))),
    ],
)
def test_digest_changes_with_the_layout(changed: tuple[tuple[str, object], ...]) -> None:
    assert layout_with(*changed).digest != layout_with(*BASE).digest


@pytest.mark.slow
@given(schemas(), schemas())
def test_digests_are_equal_only_for_equal_layouts(one: Schema, other: Schema) -> None:
    first, second = layouts_of(one), layouts_of(other)
    for name in first.keys() & second.keys():
        same = canonical_text(first[name], first) == canonical_text(second[name], second)
        assert same == (first[name].digest == second[name].digest)
