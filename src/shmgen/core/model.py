"""The data that the stages of the generator pass on: message definitions, their layouts, and files to render.

A **field** is a member of a message as the definition declares it. A **slot** is a range of bytes in a layout. A
**row** is a line of output.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from enum import Enum
from typing import Literal, NamedTuple, NoReturn, TypeAlias

from shmgen.core.diagnostics import Span


def assert_never(value: NoReturn) -> NoReturn:
    """Raise AssertionError in a `match` statement that must cover all cases. A type checker reports a missing case."""
    raise AssertionError(f"unexpected {value!r}")


# --- Schema: the definition ---------------------------------------------------------------


class Scalar(Enum):
    """A number type of fixed size; the value is its ROS 2 name. `byte` and `char` are read as 8-bit integers."""

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
        """The size of one number of this type in bytes, which is also the alignment of the type."""
        return 1 if self is Scalar.BOOL else int(self.value.lstrip("uintfloa")) // 8

    @property
    def iec(self) -> str:
        """The IEC 61131-3 type with the same bytes, such as `LREAL`. docs/layout.md names the source of the table."""
        return _IEC[self]

    @property
    def is_float(self) -> bool:
        return self in (Scalar.FLOAT32, Scalar.FLOAT64)

    @property
    def range(self) -> tuple[int, int] | None:
        """The smallest and the largest integer of this type, or None for a float."""
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


_ELSEWHERE = (
    "BOOL:bool BYTE:uint8 WORD:uint16 DWORD:uint32 LWORD:uint64 CHAR:char STRING:string WSTRING:wstring WCHAR:uint16 "
    "TIME:builtin_interfaces/Duration LTIME:builtin_interfaces/Duration DT:builtin_interfaces/Time "
    "DATE_AND_TIME:builtin_interfaces/Time "
    "boolean:bool octet:byte wchar:uint16 wchar_t:uint16 short:int16 int:int32 integer:int32 long:int64 "
    "ushort:uint16 uint:uint32 unsigned:uint32 ulong:uint64 size_t:uint64 ssize_t:int64 "
    "float:float32 real:float32 double:float64 single:float32 "
    "str:string String:string text:string u16string:wstring bytes:uint8[] bytearray:uint8[]"
)
OTHER_NAMES = {scalar.iec: scalar.value for scalar in Scalar if scalar is not Scalar.BOOL}
OTHER_NAMES |= {f"{scalar.value}_t": scalar.value for scalar in Scalar}
OTHER_NAMES |= dict(pair.split(":", 1) for pair in _ELSEWHERE.split())
"""The ROS type for a name from IEC 61131-3, C, C++, IDL or Python: `float64` for `LREAL`. For hints only."""


class Clock(Enum):
    """The type of a ROS time or duration. `[types] time` in shmgen.toml chooses its IEC type."""

    TIME = "time"
    DURATION = "duration"


@dataclass(frozen=True, slots=True)
class String:
    """The type `string` or `wstring`. `capacity` is in bytes, or in UTF-16 code units if `wide`; None = unbounded."""

    capacity: int | None = None
    wide: bool = False


class TypeName(NamedTuple):
    """The name of a message, such as `geometry_msgs/msg/Pose` or `std_srvs/srv/SetBool_Request`.

    Services and actions such as `std_srvs/srv/SetBool` have names too, but only their parts are messages.
    """

    package: str
    kind: str
    name: str

    def __str__(self) -> str:
        return f"{self.package}/{self.kind}/{self.name}"

    @property
    def short(self) -> str:
        """The name as users write it: `geometry_msgs/Pose`."""
        return f"{self.package}/{self.name}"

    def part(self, ending: str) -> TypeName:
        """Return the name of a part of a service or an action: "_Request" -> `std_srvs/srv/SetBool_Request`."""
        return self._replace(name=self.name + ending)


@dataclass(frozen=True, slots=True)
class Ref:
    """The type of a nested message, which is stored inside the outer message."""

    name: TypeName


Element: TypeAlias = Scalar | Clock | String | Ref


@dataclass(frozen=True, slots=True)
class Array:
    """The type of an array `T[N]`, N >= 1."""

    element: Element
    length: int


@dataclass(frozen=True, slots=True)
class Sequence:
    """The type of a sequence `T[<=N]`, or of `T[]` if `capacity` is None."""

    element: Element
    capacity: int | None = None


FieldType: TypeAlias = Element | Array | Sequence


def element_of(type_: FieldType) -> Element:
    """Return the element type of an array or sequence type, or `type_` if it is any other type."""
    return type_.element if isinstance(type_, Array | Sequence) else type_


def ros_type(type_: FieldType) -> str:
    """Return a type as ROS spells it: `float64[36]`, `string<=80[<=8]`, `geometry_msgs/Point`, `time`."""
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


class Field(NamedTuple):
    """A field of a message, as the definition declares it and as shmgen.toml bounds it.

    * `written`: the type as the definition spells it. `unit`: the unit in the field's comment, such as `m/s`.
    * `word`: `byte`, `char` or `wchar` if the definition uses this type. ROS 2 distinguishes these types from numbers.
    * `sent`: the type in ROS, without the bound, if shmgen.toml has bounded the field, else None.
    * `plc`: the declaration in an imported PLC project: `rSpeed`, or `rSpeed : ARRAY[1..3] OF REAL`.
    * `align`: the minimum alignment of the field in bytes. This exceeds the alignment of `type` only for the first
      field after the members of a base structure.
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
    align: int = 1


class Constant(NamedTuple):
    """A constant of a message, which takes no bytes in a sample."""

    name: str
    type: Scalar | String
    value: Value
    span: Span
    doc: str = ""
    plc: str = ""


@dataclass(frozen=True, slots=True)
class Message:
    """A message as its definition declares it. `origin` is a path without the user's folders, `text` the source.

    `plc` is the type in an imported PLC project: `ST_Axis` for a structure, `E_State : INT` for an enumeration,
    `Speeds : alias` for an alias. `pack` limits the alignment of each member to this number of bytes. Structured Text
    calls this limit `pack_mode`.
    """

    name: TypeName
    fields: tuple[Field, ...]
    constants: tuple[Constant, ...]
    span: Span
    origin: str
    text: str
    doc: str = ""
    plc: str = ""
    pack: int = 8


class Schema(NamedTuple):
    """Definitions of messages, dependencies first. `requested` has the names of the requested messages."""

    messages: tuple[Message, ...]
    requested: frozenset[TypeName] = frozenset()


# --- Layout: where every byte goes ------------------------------------------------------------------


class TypeOptions(NamedTuple):
    """The keys of `[types]`, and the encoding rules of `[strings]`, in shmgen.toml.

    `own` maps messages to their type names in an imported PLC project.
    """

    bool: Literal["USINT", "BOOL"] = "USINT"
    time: Literal["TIME", "LTIME", "struct"] = "TIME"
    encoding: Literal["utf-8", "latin-1"] = "utf-8"
    overflow: Literal["error", "truncate"] = "error"
    names: Literal["plc", "ros"] = "plc"
    own: tuple[tuple[TypeName, str], ...] = ()


class Regions(NamedTuple):
    """The settings of `[regions]` in shmgen.toml. `mode` is None, or `group` is `""`, if the key is not set."""

    mode: int | None = None
    group: str = ""
    sync: Literal["lock", "sequence"] = "lock"


class Role(Enum):
    """The use of a slot, a range of bytes in a layout: DATA is a field, PADDING a gap.

    COUNT is the number of valid elements in the next slot. FILLER is the single byte of a message without fields,
    because IEC 61131-3 and C have no empty structure.
    """

    DATA = "data"
    COUNT = "count"
    PADDING = "padding"
    FILLER = "filler"


@dataclass(frozen=True, slots=True)
class Slot:
    """A range of `size` bytes in a message, from byte `offset`: `count` elements of `type`, or one if `count` is None.

    `align` is the alignment of `type` in bytes. In a message with a smaller `pack`, the offset may be less aligned.
    `field` is None for padding and for the filler of a message without fields.
    """

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


class Layout(NamedTuple):
    """The bytes of a message, as slots (ranges of bytes) without gaps. `digest` identifies the meaning of the bytes.

    Only messages with `requested` get a publisher and a subscriber. The others are parts of requested messages.
    """

    message: Message
    slots: tuple[Slot, ...]
    size: int
    align: int
    digest: int
    options: TypeOptions = TypeOptions()
    requested: bool = True

    @property
    def name(self) -> TypeName:
        return self.message.name

    @property
    def dependencies(self) -> tuple[TypeName, ...]:
        """The names of the nested messages, each once, in order of appearance."""
        return tuple(dict.fromkeys(slot.type.name for slot in self.slots if isinstance(slot.type, Ref)))


Layouts: TypeAlias = Mapping[TypeName, Layout]
"""Layouts by message name, dependencies first."""


class Topic(NamedTuple):
    """A topic, which the PLC reads if `to_plc`, or else writes. Slow readers can read the newest `depth` samples."""

    name: str
    type: TypeName
    to_plc: bool
    depth: int
    span: Span


class Call(NamedTuple):
    """A service or an action, as the kind of its type shows. If `on_plc`, the PLC is the server, else the client.

    The bridge waits `timeout` seconds for the response of a service, or until the server of an action accepts a goal.
    """

    name: str
    type: TypeName
    on_plc: bool
    timeout: float
    span: Span


def text_bytes(string: String) -> int:
    """Return the size of a bounded string in bytes with its NUL: n + 1 for STRING(n), 2n + 2 for WSTRING(n)."""
    assert string.capacity is not None, "bounds come before layout"
    return (string.capacity + 1) * (2 if string.wide else 1)


def text_length(text: str, string: String, encoding: str) -> int:
    """Return the length of `text` in the unit of the string's capacity: bytes, or UTF-16 units of a wstring.

    Raises UnicodeEncodeError if the encoding cannot represent the text.
    """
    return len(text.encode("utf-16-le")) // 2 if string.wide else len(text.encode(encoding))


# --- Output: text to render -----------------------------------------------------------------------------


class Output(NamedTuple):
    """A file to render from a template: its `path` below the output folder, and the `view` that the template reads.

    The template inserts the strings of the view unchanged. If `piece` is True, the result is not written to a file:
    other targets include it in their files.
    """

    path: str
    template: str
    view: object
    piece: bool = False
