"""Describes a region's type for a bag: its ROS name, its definition, its type hash and its layout."""

from __future__ import annotations

import json
from collections.abc import Callable, Iterable
from dataclasses import dataclass
from functools import cached_property

from shmgen.bridge.codec.cdr import Codec, codec
from shmgen.bridge.codec.direct import Transcoder
from shmgen.bridge.plan import closure
from shmgen.core.model import Clock, Constant, Field, Layout, Layouts, Schema, element_of, ros_type
from shmgen.core.model import Message as Definition
from shmgen.core.type_hash import TIMES, type_hash
from shmgen.drift import lockfile
from shmgen.generator import pipeline
from shmgen.live.session import Session
from shmgen.runtime import Message

_RULE = "=" * 80


@dataclass(frozen=True)
class Kind:
    """A message type of a region, with its data for a bag: ROS name, definition, type hash, layout and encoding.

    `session` has the layout of the message `request`, as ClassRegistry.session_of() returns it. All attributes raise
    ValueError if `request` names several messages.
    """

    session: Session
    request: str

    @cached_property
    def layout(self) -> Layout:
        return self.session.layout(self.request)

    @property
    def layouts(self) -> Layouts:
        return self.session.layouts([self.request])

    @cached_property
    def message(self) -> type[Message]:
        """The class that reads and writes the message in a region."""
        return self.session.message(self.request)

    @cached_property
    def definitions(self) -> tuple[Definition, ...]:
        """The definitions that a reader of the bag needs: of all nested messages, and last of the message itself."""
        laid_out = tuple(layout.message for layout in self.layouts.values())
        return closure(Schema(laid_out), self.layout.name)

    @property
    def name(self) -> str:
        """The ROS name, such as `geometry_msgs/msg/Pose`."""
        return str(self.layout.name)

    @cached_property
    def text(self) -> str:
        """The definition as ROS 2 stores it in a bag: first the message, then all nested messages."""
        return _texts(self.definitions)

    @cached_property
    def type_hash(self) -> str:
        """The type hash of REP 2016: `RIHS01_...`."""
        return type_hash(self.definitions)

    @cached_property
    def codec(self) -> Codec:
        return codec(self.definitions)

    @cached_property
    def encode(self) -> Callable[[bytes | bytearray], bytes]:
        """A function that converts a payload to CDR. The function raises ValueRejected for an invalid value."""
        return Transcoder(self.message).encode

    @cached_property
    def lock(self) -> str:
        """The text of a layout.lock for the message.

        `shmgen record` stores this text in the bag. `shmgen play` compares the stored text with the present layout.
        """
        needed = {definition.name for definition in self.definitions}
        layouts = {name: layout for name, layout in self.layouts.items() if name in needed}
        return lockfile.write(layouts, {}, pipeline.lock_settings(self.session.config))


def _texts(definitions: Iterable[Definition]) -> str:
    *parts_of_message, own = definitions
    parts = [_text(own)]
    parts += [f"{_RULE}\nMSG: {name}\n{text}" for name, text in _times(definitions).items()]
    parts += [f"{_RULE}\nMSG: {one.name.short}\n{_text(one)}" for one in reversed(parts_of_message)]
    return "".join(parts)


def _text(definition: Definition) -> str:
    constants = [_constant(one) for one in definition.constants]
    return "".join(f"{line}\n" for line in [*constants, *map(_field, definition.fields)])


def _constant(constant: Constant) -> str:
    value = constant.value
    literal = json.dumps(value, ensure_ascii=False) if isinstance(value, (str, bool)) else repr(value)
    return f"{ros_type(constant.type)} {constant.name}={literal}"


def _field(field: Field) -> str:
    """Return a field as a line of a ROS 2 .msg file, in which times, `byte` and `char` differ from ros_type()."""
    type_ = field.sent or field.type
    element = element_of(type_)
    name = field.word if field.word in ("byte", "char") else ros_type(element)
    if isinstance(element, Clock):
        name = TIMES[element].short
    return f"{ros_type(type_).replace(ros_type(element), name, 1)} {field.name}"


def _times(definitions: Iterable[Definition]) -> dict[str, str]:
    used = {
        inner
        for definition in definitions
        for field in definition.fields
        if isinstance(inner := element_of(field.type), Clock)
    }
    return {TIMES[clock].short: "int32 sec\nuint32 nanosec\n" for clock in Clock if clock in used}
