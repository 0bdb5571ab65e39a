"""Random schemas, and random values for them, for property tests."""

from __future__ import annotations

import dataclasses
import os
import random
import string
import time
from types import SimpleNamespace
from typing import Any

from hypothesis import strategies as st

from shmgen.core.diagnostics import Span
from shmgen.core.model import (
    Array,
    Clock,
    Field,
    FieldType,
    Layout,
    Layouts,
    Message,
    Ref,
    Role,
    Scalar,
    Schema,
    Sequence,
    Slot,
    String,
    TypeName,
    TypeOptions,
    ros_type,
)

SPAN = Span("random.msg")


def examples(usual: int) -> int:
    """Return the number of examples of a property test: $SHMGEN_EXAMPLES, or `usual`."""
    return int(os.environ.get("SHMGEN_EXAMPLES", usual))


def messages(usual: int) -> int:
    """Return the number of random messages of each type: $SHMGEN_MESSAGES, or `usual`."""
    return int(os.environ.get("SHMGEN_MESSAGES", usual))


@st.composite
def schemas(draw: st.DrawFn) -> Schema:
    """Draw one to five messages. Each may contain the messages before it."""
    messages: list[Message] = []
    for number in range(draw(st.integers(1, 5))):
        name = TypeName("random_msgs", "msg", f"Random{number}")
        types = draw(st.lists(field_types([message.name for message in messages]), max_size=8))
        fields = tuple(
            Field(
                f"f{index}_{draw(st.sampled_from(('x', 'type', 'class')))}",
                type_,
                ros_type(type_),
                SPAN,
                align=draw(st.sampled_from((1, 1, 1, 2, 4, 8))),
            )
            for index, type_ in enumerate(types)
        )
        pack = draw(st.sampled_from((8, 8, 1, 2, 4)))
        messages.append(Message(name, fields, (), SPAN, "random", "", pack=pack))
    return Schema(tuple(messages), frozenset(message.name for message in messages))


def field_types(known: list[TypeName]) -> st.SearchStrategy[FieldType]:
    elements: st.SearchStrategy[Any] = st.one_of(
        st.sampled_from(Scalar),
        st.sampled_from(Clock),
        st.builds(String, st.integers(1, 20), st.booleans()),
        *([st.sampled_from(known).map(Ref)] if known else []),
    )
    return st.one_of(
        elements,
        st.builds(Array, elements, st.integers(1, 5)),
        st.builds(Sequence, elements, st.integers(1, 5)),
    )


def random_message(layout: Layout, layouts: Layouts, seed: random.Random) -> SimpleNamespace:
    """Return an object with the attributes of a ROS message and a random value in each field."""
    message = SimpleNamespace()
    for slot in layout.slots:
        if slot.role is Role.DATA:
            setattr(message, slot.name, _random_field(slot, layouts, layout, seed))
    return message


def _random_field(slot: Slot, layouts: Layouts, layout: Layout, seed: random.Random) -> Any:
    if slot.count is None:
        return _random_element(slot, layouts, layout, seed)
    assert slot.field is not None
    count = slot.count if isinstance(slot.field.type, Array) else seed.randint(0, slot.count)
    if slot.size > 10_000 and isinstance(slot.type, Scalar) and slot.type is Scalar.UINT8:
        return seed.randbytes(count)
    return [_random_element(slot, layouts, layout, seed) for _ in range(count)]


def _random_element(slot: Slot, layouts: Layouts, layout: Layout, seed: random.Random) -> Any:
    match slot.type:
        case Scalar.BOOL:
            return seed.random() < 0.5
        case Scalar.FLOAT32:
            return float(seed.randint(-(2**23), 2**23)) / 8
        case Scalar.FLOAT64:
            return seed.uniform(-1e9, 1e9)
        case Scalar() as scalar:
            assert scalar.range is not None
            return seed.choice([seed.randint(*scalar.range), *scalar.range])
        case Clock():
            return _random_clock(slot.type, layout.options, seed)
        case String():
            return _random_text(slot.type, layout.options, seed)
        case Ref(name):
            return random_message(layouts[name], layouts, seed)


def _random_clock(clock: Clock, options: TypeOptions, seed: random.Random) -> Any:
    """Return a random time in the range of the configured IEC time type."""
    if options.time == "TIME":
        around = int(time.time()) + seed.randint(-(10**6), 10**6)
        second = around if clock is Clock.TIME else seed.randint(0, 4_000_000)
        return SimpleNamespace(sec=second, nanosec=seed.randint(0, 999) * 10**6)
    least, most = (0, 18_446_744_072) if options.time == "LTIME" else (-(2**31), 2**31 - 1)
    second = seed.choice([least, most, seed.randint(least, most)])
    return SimpleNamespace(sec=second, nanosec=seed.choice([0, 999_999_999, seed.randint(0, 999_999_999)]))


ASCII = string.ascii_letters + string.punctuation
BEYOND_ASCII = {"utf-8": "\xe9\N{SNOWMAN}\N{GRINNING FACE}", "latin-1": "\xe9\xdf\xff"}


def _random_text(type_: String, options: TypeOptions, seed: random.Random) -> str:
    """Return a random text that fits. With `overflow = "truncate"`, it may be up to twice as long as the capacity."""
    assert type_.capacity is not None
    beyond = BEYOND_ASCII["utf-8" if type_.wide else options.encoding]
    room = seed.randint(0, type_.capacity * (1 if options.overflow == "error" else 2))
    text = "".join(seed.choices(ASCII + 8 * beyond, k=room))
    return text if options.overflow == "truncate" else cut(text, type_, options)


def cut(text: str, type_: String, options: TypeOptions) -> str:
    """Truncate a text to its capacity without splitting a character."""
    encoding, unit = ("utf-16-le", 2) if type_.wide else (options.encoding, 1)
    assert type_.capacity is not None
    while len(text.encode(encoding)) > type_.capacity * unit:
        text = text[:-1]
    return text


def arriving(message: Any, layout: Layout, layouts: Layouts) -> Any:
    """Return a message with all its texts truncated."""

    def element(slot: Slot, value: Any) -> Any:
        match slot.type:
            case String():
                return cut(value, slot.type, layout.options)
            case Ref(name):
                return arriving(value, layouts[name], layouts)
            case _:
                return value

    truncated = SimpleNamespace(**vars(message))
    for slot in layout.slots:
        if slot.role is Role.DATA and isinstance(slot.type, String | Ref):
            value = getattr(message, slot.name)
            value = element(slot, value) if slot.count is None else [element(slot, item) for item in value]
            setattr(truncated, slot.name, value)
    return truncated


def plain(value: Any) -> Any:
    """Convert a message to dicts, lists and numbers, for comparisons."""
    if hasattr(value, "sec") and hasattr(value, "nanosec"):
        return {"sec": value.sec, "nanosec": value.nanosec}
    if hasattr(value, "_names_"):
        return {name: plain(getattr(value, name)) for name in value._names_}
    if dataclasses.is_dataclass(value):
        names = [field.name for field in dataclasses.fields(value)]  # rosbags: fields, constants, its own, the filler
        fields = [name for name in names if name[0].islower() and name != "structure_needs_at_least_one_member"]
        return {name: plain(getattr(value, name)) for name in fields}
    if isinstance(value, SimpleNamespace):
        return {name: plain(item) for name, item in vars(value).items()}
    if isinstance(value, (str, bool, int, float)):
        return value
    return value.tolist() if hasattr(value, "tolist") else [plain(item) for item in value]
