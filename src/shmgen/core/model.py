"""The data between the stages: *Schema* is the user's words, *Layout* is bytes, *Output* is text to be.

A **field** is the user's, a **slot** is bytes, a **row** is printed.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import field
from enum import Enum
from typing import Literal, NamedTuple, NoReturn, TypeAlias

from shmgen.core.diagnostics import Span
from shmgen.core.fast_dataclass import dataclass


def assert_never(value: NoReturn) -> NoReturn:
    """typing.assert_never of Python 3.11, for `match` statements that must stay complete."""
    raise AssertionError(f"unexpected {value!r}")


# --- Schema: what the definition says ---------------------------------------------------------------


class Scalar(Enum):
    """A number of fixed size; the value is its ROS 2 name. `byte` and `char` are read as one of these."""

    BOOL = "bool"
    INT8 = "int8"
    UINT8 = "uint8"
    INT16 = "int16"
    UINT16 = "uint16"
    INT32 = "int32"
    UINT32 = "uint32"
    INT64 = "int64"
    UINT64 = "uint64"
    FLOAT32 = "float32"
    FLOAT64 = "float64"

    @property
    def size(self) -> int:
        """Bytes, and at the same time the alignment."""
        return 1 if self is Scalar.BOOL else int(self.value.lstrip("uintfloa")) // 8

    @property
    def iec(self) -> str:
        """The IEC 61131-3 type of the same bytes, after Table I of the paper with UINT and UDINT put right."""
        return _IEC[self]

    @property
    def is_float(self) -> bool:
        return self in (Scalar.FLOAT32, Scalar.FLOAT64)

    @property
    def range(self) -> tuple[int, int] | None:
        """Smallest and largest integer, or None for a float."""
        if self is Scalar.BOOL:
            return 0, 1
        if self.is_float:
            return None
        bits = 8 * self.size
        return (0, 2**bits - 1) if self.value.startswith("u") else (-(2 ** (bits - 1)), 2 ** (bits - 1) - 1)


_IEC = {
    Scalar.BOOL: "USINT",
    Scalar.INT8: "SINT",
    Scalar.UINT8: "USINT",
    Scalar.INT16: "INT",
    Scalar.UINT16: "UINT",
    Scalar.INT32: "DINT",
    Scalar.UINT32: "UDINT",
    Scalar.INT64: "LINT",
    Scalar.UINT64: "ULINT",
    Scalar.FLOAT32: "REAL",
    Scalar.FLOAT64: "LREAL",
}


class Clock(Enum):
    """A ROS time or duration, whichever dialect spelled it; travels as the configured IEC time type."""

    TIME = "time"
    DURATION = "duration"


@dataclass(frozen=True, slots=True)
class String:
    """`string` or `wstring`; `capacity` in characters (wide: UTF-16 code units, else bytes), None = unbounded."""

    capacity: int | None = None
    wide: bool = False


class TypeName(NamedTuple):
    """`geometry_msgs/msg/Pose`; the halves of a service are `std_srvs/srv/SetBool_Request` and `_Response`.

    A service or an action itself, `std_srvs/srv/SetBool`, has a name too; only its parts are messages.
    """

    package: str
    kind: str
    name: str

    def __str__(self) -> str:
        return f"{self.package}/{self.kind}/{self.name}"

    @property
    def short(self) -> str:
        """As users write it: `geometry_msgs/Pose`."""
        return f"{self.package}/{self.name}"

    def part(self, ending: str) -> TypeName:
        """A message of a service or action: "_Request" -> `std_srvs/srv/SetBool_Request`."""
        return self._replace(name=self.name + ending)


@dataclass(frozen=True, slots=True)
class Ref:
    """Another message, held by value."""

    name: TypeName


Element: TypeAlias = Scalar | Clock | String | Ref


@dataclass(frozen=True, slots=True)
class Array:
    """`T[N]`, N >= 1."""

    element: Element
    length: int


@dataclass(frozen=True, slots=True)
class Sequence:
    """`T[<=N]`, or `T[]` where `capacity` is None."""

    element: Element
    capacity: int | None = None


FieldType: TypeAlias = Element | Array | Sequence


def element_of(type_: FieldType) -> Element:
    """What an array or sequence holds; anything else is its own element."""
    return type_.element if isinstance(type_, Array | Sequence) else type_


def ros_type(type_: FieldType) -> str:
    """As ROS spells it, bounds included: `float64[36]`, `string<=80[<=8]`, `geometry_msgs/Point`, `time`."""
    match type_:
        case Scalar() | Clock():
            return str(type_.value)
        case String(capacity, wide):
            return ("wstring" if wide else "string") + ("" if capacity is None else f"<={capacity}")
        case Ref(name):
            return name.short
        case Array(element, length):
            return f"{ros_type(element)}[{length}]"
        case Sequence(element, capacity):
            return ros_type(element) + ("[]" if capacity is None else f"[<={capacity}]")
        case _:
            assert_never(type_)


Value: TypeAlias = bool | int | float | str
Default: TypeAlias = Value | tuple[Value, ...]


@dataclass(frozen=True, slots=True)
class Field:
    """One member. `written` is the type as the definition spells it; `unit` was found in `[m/s]` in the comment.

    `word` is `byte`, `char` or `wchar` where ROS 2 tells it from a number, as we do not. `sent` is the type before
    shmgen.toml bounded it, which is what ROS knows; None where that is `type`. `plc` is what a PLC calls it, where that
    was imported: `rSpeed`, or `rSpeed : ARRAY[1..3] OF REAL`.
    """

    name: str
    type: FieldType
    written: str
    span: Span
    doc: str = ""
    unit: str = ""
    default: Default | None = None
    word: str = ""
    sent: FieldType | None = None
    plc: str = ""


@dataclass(frozen=True, slots=True)
class Constant:
    """A name for a value; it takes no bytes."""

    name: str
    type: Scalar | String
    value: Value
    span: Span
    doc: str = ""
    plc: str = ""


@dataclass(frozen=True, slots=True)
class Message:
    """One definition. `origin` says where it came from (never an absolute path), `text` is its source.

    `plc` is what a PLC calls it: `ST_Axis`, or `E_State : INT` of an enumeration, or `Speeds : alias`.
    """

    name: TypeName
    fields: tuple[Field, ...]
    constants: tuple[Constant, ...]
    span: Span
    origin: str
    text: str
    doc: str = ""
    plc: str = ""


@dataclass(frozen=True, slots=True)
class Schema:
    """Messages with dependencies first; closed: every Ref resolves. `requested` are those the user named."""

    messages: tuple[Message, ...]
    requested: frozenset[TypeName] = frozenset()


# --- Layout: where every byte goes ------------------------------------------------------------------


@dataclass(frozen=True, slots=True)
class TypeOptions:
    """`[types]` and the encoding rules of `[strings]` in shmgen.toml.

    `own` are the names that an imported PLC project has for messages.
    """

    bool: Literal["USINT", "BOOL"] = "USINT"
    time: Literal["TIME", "LTIME", "struct"] = "TIME"
    encoding: Literal["utf-8", "latin-1"] = "utf-8"
    overflow: Literal["error", "truncate"] = "error"
    names: Literal["plc", "ros"] = "plc"
    own: tuple[tuple[TypeName, str], ...] = ()


@dataclass(frozen=True, slots=True)
class Regions:
    """`[regions]` in shmgen.toml: mode and group of the files, None and "" where not said, and what orders access."""

    mode: int | None = None
    group: str = ""
    sync: Literal["lock", "sequence"] = "lock"


class Role(Enum):
    """DATA carries a field, COUNT says how many elements of the next slot are valid, PADDING is a gap.

    FILLER is the single byte of a message without fields (IEC 61131-3 and C know no empty structure).
    """

    DATA = "data"
    COUNT = "count"
    PADDING = "padding"
    FILLER = "filler"


@dataclass(frozen=True, slots=True)
class Slot:
    """`count` elements of `type` from byte `offset` on, `size` bytes in all; `count` None means one, no array."""

    name: str
    type: Element
    count: int | None
    offset: int
    size: int
    align: int
    role: Role = Role.DATA
    field: Field | None = None

    @property
    def element_size(self) -> int:
        return self.size // (self.count or 1)


@dataclass(frozen=True, slots=True)
class Layout:
    """A message as bytes: the slots tile it without gaps. `digest` changes exactly when the bytes' meaning does."""

    message: Message
    slots: tuple[Slot, ...]
    size: int
    align: int
    digest: int
    options: TypeOptions = field(default_factory=TypeOptions)
    requested: bool = True

    @property
    def name(self) -> TypeName:
        return self.message.name

    @property
    def dependencies(self) -> tuple[TypeName, ...]:
        """Messages held by value, each once, in order of appearance."""
        return tuple(dict.fromkeys(slot.type.name for slot in self.slots if isinstance(slot.type, Ref)))


Layouts: TypeAlias = Mapping[TypeName, Layout]
"""Dependencies first."""


@dataclass(frozen=True, slots=True)
class Topic:
    """A message under a ROS name; `to_plc` says who reads, `depth` how many samples a slow reader can still fetch."""

    name: str
    type: TypeName
    to_plc: bool
    depth: int
    span: Span


@dataclass(frozen=True, slots=True)
class Service:
    """A service (std_srvs/srv/SetBool) under a ROS name; `on_plc` says who serves, `timeout` is in seconds."""

    name: str
    type: TypeName
    on_plc: bool
    timeout: float
    span: Span


@dataclass(frozen=True, slots=True)
class Action:
    """An action (control_msgs/action/GripperCommand) under a ROS name; the rest as of a Service."""

    name: str
    type: TypeName
    on_plc: bool
    timeout: float
    span: Span


def text_bytes(string: String) -> int:
    """Bytes a bounded string takes with its terminating NUL: STRING(n) n+1, WSTRING(n) 2(n+1)."""
    assert string.capacity is not None, "bounds come before layout"
    return (string.capacity + 1) * (2 if string.wide else 1)


def text_length(text: str, string: String, encoding: str) -> int:
    """As a capacity counts: bytes in `encoding`, of a wstring UTF-16 code units. Raises UnicodeEncodeError."""
    return len(text.encode("utf-16-le")) // 2 if string.wide else len(text.encode(encoding))


# --- Output: text to be -----------------------------------------------------------------------------


@dataclass(frozen=True, slots=True)
class Output:
    """A file to print: `path` below the output folder, the template, and a view of finished strings.

    A `piece` is printed for the targets that come after this one, and is no file of its own.
    """

    path: str
    template: str
    view: object
    piece: bool = False
