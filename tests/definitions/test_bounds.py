"""Test which setting bounds a field, and the hint if no setting does."""

from __future__ import annotations

from pathlib import Path

import pytest

from shmgen.config.entries import Bound, Bounds
from shmgen.core.diagnostics import Rejected, Report, Span
from shmgen.core.model import Field, Message, Scalar, Schema, Sequence, String, TypeName
from shmgen.generator import bounds

TOML = Span("shmgen.toml")
NAME = TypeName("demo_msgs", "msg", "Foo")


def schema(*fields: Field, origin: str = "msgs") -> Schema:
    return Schema((Message(NAME, fields, (), Span("Foo.msg"), origin, ""),), frozenset({NAME}))


def unbounded_field(written: str = "int8[]") -> Field:
    return Field("many", Sequence(Scalar.INT8), written, Span("Foo.msg", 1))


def apply_bounds(unbounded: Schema, sequences: dict[str, int], strings: dict[str, int] | None = None) -> Field:
    tables = [{key: Bound(value, TOML) for key, value in table.items()} for table in (strings or {}, sequences)]
    (message,) = bounds.apply(unbounded, Bounds(*tables), Report()).messages
    return message.fields[0]


@pytest.mark.parametrize(
    ("keys", "capacity"),
    [
        ({"demo_msgs": 1}, 1),
        ({"demo_msgs/Foo": 2}, 2),
        ({"demo_msgs/Foo.many": 3}, 3),
        ({"demo_msgs": 1, "demo_msgs/Foo": 2}, 2),
        ({"demo_msgs": 1, "demo_msgs/Foo": 2, "demo_msgs/Foo.many": 3}, 3),
    ],
)
def test_most_specific_bound_wins(keys: dict[str, int], capacity: int) -> None:
    field = apply_bounds(schema(unbounded_field()), keys)
    assert field.type == Sequence(Scalar.INT8, capacity)
    assert field.sent == Sequence(Scalar.INT8), "the type in ROS has no bound"
    text_field = Field("many", String(), "string", Span("Foo.msg", 1))
    assert apply_bounds(schema(text_field), {}, keys).type == String(capacity)


def test_field_with_its_own_bound_is_unchanged() -> None:
    field = Field("many", Sequence(Scalar.INT8, 4), "int8[<=4]", Span("Foo.msg", 1))
    assert apply_bounds(schema(field), {"demo_msgs": 9}) is field


@pytest.mark.parametrize(
    ("written", "origin", "hint"),
    [
        ("int8[]", "msgs", "write `int8[<=N] many`, or set"),
        ("sequence<int8>", "msgs", "write `sequence<int8, N> many`, or set"),
        ("numbers", "msgs", "set"),
        ("int8[]", "built-in jazzy", "set"),
        ("int8[]", "/opt/ros of ROS 2", "set"),
    ],
)
def test_hint_suggests_how_to_set_a_bound(written: str, origin: str, hint: str, tmp_path: Path) -> None:
    with pytest.raises(Rejected) as rejected:
        apply_bounds(schema(unbounded_field(written), origin=origin), {})
    assert rejected.value.diagnostics[0].hint.startswith(f'{hint} "demo_msgs/Foo.many" = N under [bounds]')
