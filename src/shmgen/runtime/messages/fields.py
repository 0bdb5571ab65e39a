"""Create the attributes of a generated message class from its table of fields.

Setting an attribute checks the value, as `publish` does. So a structure never holds a value that a peer cannot read.
"""

from __future__ import annotations

import ctypes
from collections.abc import Iterable, Iterator
from functools import lru_cache
from typing import TYPE_CHECKING, Any

from shmgen.runtime.messages import walker
from shmgen.runtime.messages.numbers import check
from shmgen.runtime.messages.steps import CODES, COUNT, Step, steps_of

_C_NAMES = {"float32": "c_float", "float64": "c_double"}
CTYPES = {kind: getattr(ctypes, _C_NAMES.get(kind, f"c_{kind}")) for kind in CODES}
KINDS = {ctype: kind for kind, ctype in CTYPES.items()}
_KEPT = 256
_SHOWN = 32


class Field:
    """The attribute for a field that ctypes cannot represent as ROS does: a string, a time or an array.

    An array of numbers or messages is a view: an assignment to an element changes the structure.
    """

    def __init__(self, step: Step) -> None:
        self.step = step
        self._element = CTYPES.get(step.kind) if isinstance(step.kind, str) else step.kind

    def __get__(self, structure: Any, owner: type) -> Any:
        if structure is None:
            return self
        step = self.step
        if not step.length:
            return walker.decode_element(step, _load(structure, step), 0)
        if self._element is None:
            return walker.decode_elements(step, _load(structure, step), 0, self._count(structure), ())
        return array_of(self._element, self._count(structure), step.path).from_buffer(structure, step.offset)

    def _count(self, structure: Any) -> int:
        return walker.decode_count(self.step, structure, 0)

    def __set__(self, structure: Any, value: Any) -> None:
        step, count = self.step, 1
        data = bytearray(step.end - step.offset)
        if step.length:
            count, _ = walker.encode_array(step, value, data, 0)
        else:
            walker.encode_element(step.kind, value, data, 0, step.size, step.path)
        ctypes.memmove(ctypes.addressof(structure) + step.offset, bytes(data), count * step.size)
        if step.count_at >= 0:
            COUNT.pack_into(structure, step.count_at, count)


class Number(property):
    """The attribute for a single number: it checks a value before ctypes stores the value.

    ctypes alone would store only the lower bits of a number that is too large.
    """

    def __init__(self, step: Step, stored: Any) -> None:
        def assign(structure: Any, value: Any) -> None:
            check(step.kind, value, step.path)
            stored.__set__(structure, value)

        super().__init__(stored.__get__, assign)
        self.offset, self.size = step.offset, step.size


class _Tabled(type(ctypes.Structure)):  # type: ignore[misc]
    """The metaclass of message classes: creates the fields of a generated class from the table in the class body.

    A class without a table defines `_fields_`, as ctypes requires.
    """

    def __new__(cls, name: str, bases: tuple[type, ...], body: dict[str, Any]) -> Any:
        if "_table_version_" not in body and not {"_digest_", "_encode"} <= body.keys():
            return super().__new__(cls, name, bases, body)
        steps = steps_of(name, body)
        body["_fields_"] = tuple(_stored(steps, body["_size_"]))
        body["_steps_"], body["_names_"] = steps, tuple(step.name for step in steps)
        return super().__new__(cls, name, bases, body)

    def __init__(cls, name: str, bases: tuple[type, ...], body: dict[str, Any]) -> None:
        super().__init__(name, bases, body)  # from Python 3.13 on, ctypes creates its fields here
        for step in body.get("_steps_", ()):
            if step.length or (isinstance(step.kind, str) and step.kind not in CTYPES):
                setattr(cls, step.name, Field(step))
            elif isinstance(step.kind, str):
                setattr(cls, step.name, Number(step, cls.__dict__[step.name]))
        if "_steps_" in body:
            cls._initial_ = _initial(cls, body.get("_defaults_", ()))


if TYPE_CHECKING:  # versions of the stubs disagree on the type of a structure
    TabledStructure = ctypes.LittleEndianStructure
else:

    class TabledStructure(ctypes.LittleEndianStructure, metaclass=_Tabled):
        """The base class of message classes. Its metaclass creates the fields from the table in a generated class."""

        __slots__ = ()


@lru_cache(_KEPT)
def array_of(ctype: Any, length: int, path: str) -> Any:
    """Return an array type of ctypes with `length` elements of type `ctype`, for views of arrays in a structure.

    The type checks numbers that are assigned to elements. `path` is the name of the field in error messages.
    """
    is_checked = ctype in KINDS and ctype is not ctypes.c_double  # every value that ctypes accepts for a float64 fits
    base = _Numbers if is_checked else _Elements
    return type(base.__name__[1:], (base, ctypes.Array), {"_type_": ctype, "_length_": length, "_path": path})


def short_repr(value: Any) -> str:
    """Return the text of a value for people. An array is printed like a list, with at most 32 elements."""
    if not isinstance(value, (ctypes.Array, list, tuple)) or (isinstance(value, tuple) and hasattr(value, "_fields")):
        return repr(value)
    items = [short_repr(item) for item in value[:_SHOWN]]
    if len(value) > _SHOWN:
        items.append(f"... {len(value)} in all")
    return f"[{', '.join(items)}]"


class _Elements:
    """Base class of arrays of ctypes that print like a list."""

    def __repr__(self) -> str:
        return short_repr(self)


class _Numbers(_Elements):
    """Base class of arrays of ctypes that check each assigned number. Errors name the element, as in `data[17]`."""

    _type_: Any
    _path: str

    def __setitem__(self, where: int | slice, value: Any) -> None:
        if isinstance(where, slice):
            value = self._check_items(range(len(self))[where], value)  # type: ignore[arg-type]
        else:
            check(KINDS[self._type_], value, f"{self._path}[{where}]")
        super().__setitem__(where, value)  # type: ignore[misc]

    def _check_items(self, positions: range, value: Iterable[Any]) -> list[Any]:
        items = value.tolist() if hasattr(value, "tolist") else list(value)
        for position, item in zip(positions, items):  # noqa: B905 ctypes compares the lengths
            check(KINDS[self._type_], item, f"{self._path}[{position}]")
        return items


def _stored(steps: Iterable[Step], size: int) -> Iterator[tuple[str, Any]]:
    """Yield the name and the ctypes type of each part of a structure: fields, counts before sequences, and padding."""
    end = 0
    for step in steps:
        start = step.offset if step.count_at < 0 else step.count_at
        yield from _padding(end, start)
        if step.count_at >= 0:
            yield f"_{step.name}_count", ctypes.c_uint32
            yield from _padding(start + 4, step.offset)
        if step.length or step.kind not in CTYPES:
            whole = ctypes.c_uint8 * (step.end - step.offset)
            is_message = not step.length and not isinstance(step.kind, str)
            yield (step.name, step.kind) if is_message else (f"{step.name}, stored", whole)
        else:
            yield step.name, CTYPES[step.kind]
        end = step.end
    yield from _padding(end, size)


def _load(structure: Any, step: Step) -> bytes:
    return ctypes.string_at(ctypes.addressof(structure) + step.offset, step.end - step.offset)


def _padding(start: int, end: int) -> Iterator[tuple[str, Any]]:
    if end > start:
        yield f"padding at {start}", ctypes.c_uint8 * (end - start)


def _initial(kind: Any, defaults: Iterable[tuple[str, Any]]) -> bytes:
    """Return the bytes of a message with the defaults of its definition, or `b""` if all bytes are zero."""
    data = bytearray(ctypes.sizeof(kind))
    for step in kind._steps_:
        inner = b"" if isinstance(step.kind, str) or step.count_at >= 0 else step.kind._initial_
        if inner:
            data[step.offset : step.end] = inner * max(1, step.length)
    message = kind.from_buffer(data)
    for name, value in defaults:
        setattr(message, name, value)
    return bytes(message) if any(bytes(message)) else b""
