"""Turns a Layout into the statements of a generated class that move a ROS message to bytes and back.

All numbers, times and strings of a message, nested ones included, go through one precompiled `struct.Struct`;
arrays go by slice. A Struct spans an array as a gap of `x`, which `pack_into` fills with zeros; where that would
cost more than a second Struct (over 512 bytes), a second one begins.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import field
from itertools import groupby
from typing import NamedTuple

from shmgen.core.fast_dataclass import dataclass
from shmgen.core.model import (
    Clock,
    Layout,
    Layouts,
    Ref,
    Role,
    Scalar,
    Slot,
    String,
    TypeName,
    TypeOptions,
    assert_never,
)
from shmgen.targets.python.names import python_member

WIDEST_GAP = 512
LATE = 4096
"""Arrays of this many bytes and more skip the scratch copy: they are copied once, straight into the region."""

TYPECODES = {
    Scalar.BOOL: "?",
    Scalar.INT8: "b",
    Scalar.UINT8: "B",
    Scalar.INT16: "h",
    Scalar.UINT16: "H",
    Scalar.INT32: "i",
    Scalar.UINT32: "I",
    Scalar.INT64: "q",
    Scalar.UINT64: "Q",
    Scalar.FLOAT32: "f",
    Scalar.FLOAT64: "d",
}
CLOCK_CODES = {"TIME": "I", "LTIME": "Q", "struct": "iI"}
_CLOCK_UNITS = {"TIME": "milliseconds", "LTIME": "nanoseconds", "struct": "seconds_nanoseconds"}


_USED = {"message", "into", "at", "late", "data", "error", "len", "memoryview"}
_USED |= {"ctypes", "runtime", "struct", "typing", "values"}
"""What the statements refer to beside the variables they make."""


@dataclass(slots=True)
class StructRun:
    """One precompiled Struct: where in the payload it starts and ends, what it packs and unpacks to."""

    offset: int
    end: int
    codes: list[str] = field(default_factory=list)
    values: list[str] = field(default_factory=list)
    targets: list[str] = field(default_factory=list)

    @property
    def format(self) -> str:
        """`<7d` for seven doubles in a row; strings and gaps already carry their number."""
        merged = []
        for code, same in groupby(self.codes):
            count = len(list(same))
            merged.append(code * count if len(code) > 1 else f"{count if count > 1 else ''}{code}")
        return "<" + "".join(merged)


@dataclass(slots=True)
class Codec:
    """Statements: encode is `locals`, `before`, the Structs, `after`; decode is `locals`, the Structs, `decoded`.

    `rows` are the path of each member and the code it is packed with, to find the culprit when a pack fails.
    `class_names` maps a message to the name it is imported as.
    """

    layouts: Layouts
    class_names: Mapping[TypeName, str]
    runs: list[StructRun] = field(default_factory=list)
    locals: list[str] = field(default_factory=list)
    before: list[str] = field(default_factory=list)
    after: list[str] = field(default_factory=list)
    decoded: list[str] = field(default_factory=list)
    rows: list[tuple[str, str]] = field(default_factory=list)
    names: set[str] = field(default_factory=lambda: set(_USED))

    def message(self, layout: Layout, base: int = 0, owner: str = "message", prefix: str = "") -> None:
        """Walks the slots of a message that begins at byte `base` and is held by the variable `owner`."""
        slots = iter(layout.slots)
        for slot in slots:
            count_at = None
            if slot.role is Role.COUNT:
                count_at = base + slot.offset
                slot = next(slot for slot in slots if slot.role is Role.DATA)
            if slot.role is not Role.DATA:
                continue
            value = f"{owner}.{python_member(slot.name)}"
            leaf = _Leaf(slot, base + slot.offset, value, prefix + slot.name, layout.options, count_at)
            if slot.count is not None:
                self._array(leaf)
            elif isinstance(slot.type, Ref):
                inner = self._local(leaf.path)
                self.locals.append(f"{inner} = {value}")
                self.message(self.layouts[slot.type.name], leaf.offset, inner, f"{leaf.path}.")
            else:
                self._single(leaf, slot.type)

    def encode_lines(self, structs: Sequence[str]) -> Iterator[str]:
        """`structs` are the names of the precompiled Structs, one for each run."""
        yield from (*self.locals, *self.before)
        for name, run in zip(structs, self.runs, strict=True):
            yield from _exploded(f"{name}.pack_into(", ["into", place(run.offset), *run.values], ")")
        yield from self.after

    def decode_lines(self, structs: Sequence[str]) -> Iterator[str]:
        yield from self.locals
        for name, run in zip(structs, self.runs, strict=True):
            end = f") = {name}.unpack_from(data, {place(run.offset)})"
            if len(run.targets) == 1:
                yield f"({run.targets[0]},{end}"
            else:
                yield from _exploded("(", run.targets, end)
        yield from self.decoded

    def _single(self, leaf: _Leaf, type_: Scalar | String | Clock) -> None:
        value, path = leaf.value, leaf.path
        match type_:
            case Scalar():
                code = TYPECODES[type_]
                checked = f'values.boolean({value}, "{path}")' if type_ is Scalar.BOOL else value
                self._pack(leaf.offset, leaf.slot.size, [code], checked, [value])
                self.rows.append((path, code))
            case String(capacity, _):
                raw = self._local(path)
                encoded = f'{text_in(type_, leaf.options)}({value}, {capacity}, "{path}"{leaf.cut})'
                self._pack(leaf.offset, leaf.slot.size, [f"{leaf.slot.size}s"], encoded, [raw])
                self.decoded.append(f"{value} = {text_out(type_, leaf.options)}({raw})")
                self.rows.append((path, ""))
            case Clock():
                codes = list(CLOCK_CODES[leaf.options.time])
                raws = [self._local(path) for _ in codes]
                splat = "*" if len(codes) > 1 else ""
                encoded = f'{splat}{clock_in(type_, leaf.options)}({value}, "{path}")'
                self._pack(leaf.offset, leaf.slot.size, codes, encoded, raws)
                decoded = f"{clock_out(type_, leaf.options)}({', '.join(raws)})"
                self.decoded.append(f"{value} = values.set_clock({value}, {decoded})")
                self.rows.append((path, ""))
            case _:
                assert_never(type_)

    def _array(self, leaf: _Leaf) -> None:
        slot, path, item = leaf.slot, leaf.path, leaf.slot.element_size
        variable = self._local(path)
        count: str = str(slot.count)
        if leaf.count_at is not None:
            count = self._local(f"{path}_count")
            if isinstance(slot.type, Ref):
                length = f'values.check_count({variable}, "{path}", None, {slot.count})'
            else:
                length = f"len({variable})" if item == 1 else f"len({variable}) // {item}"
            self._pack(leaf.count_at, 4, ["I"], length, [count])
            self.decoded.append(f'{count} = values.count({count}, {slot.count}, "{path}")')
        self.rows.append((path, ""))
        if isinstance(slot.type, Ref):
            made = self.class_names[slot.type.name]
            at = place(leaf.offset)
            self.before.append(f"{variable} = {leaf.value}")
            self.after.append(
                f'values.each({variable}, {made}._encode, into, {at}, {item}, "{path}", late, {leaf.rule})'
            )
            arguments = f"data, {at}, {item}, {count}, {made}, {leaf.value}"
            self.decoded.append(f"{leaf.value} = values.each_back({arguments})")
        else:
            self.before.append(f"{variable} = {self._array_value(leaf, slot.type)}")
            self._array_store(leaf, variable)
            self.decoded.append(f"{leaf.value} = {self._array_back(leaf, slot.type, count)}")

    def _array_value(self, leaf: _Leaf, type_: Scalar | String | Clock) -> str:
        value, path, item = leaf.value, leaf.path, leaf.slot.element_size
        match type_:
            case Scalar():
                return f'values.numbers({value}, "{TYPECODES[type_]}", {item}, "{path}", {leaf.rule})'
            case String(capacity, _):
                encode = text_in(type_, leaf.options)
                return f'values.texts({value}, {encode}, {capacity}, {item}, "{path}"{leaf.cut}, {leaf.rule})'
            case Clock():
                convert, code = clock_in(type_, leaf.options), CLOCK_CODES[leaf.options.time]
                return f'values.clocks({value}, "{code}", {convert}, "{path}", {leaf.rule})'
            case _:
                assert_never(type_)

    def _array_store(self, leaf: _Leaf, variable: str) -> None:
        slot, at = leaf.slot, place(leaf.offset)
        if slot.size >= LATE:
            view = variable if isinstance(slot.type, Scalar) else f"memoryview({variable})"
            self.after.append(f"late.append(({at}, {slot.size}, {view}))")
        elif leaf.count_at is None:
            self.after.append(f"into[{at} : {place(leaf.offset + slot.size)}] = {variable}")
        else:
            self.after.append(f"into[{at} : {at} + len({variable})] = {variable}")

    def _array_back(self, leaf: _Leaf, type_: Scalar | String | Clock, count: str) -> str:
        slot, options, at = leaf.slot, leaf.options, place(leaf.offset)
        fixed = leaf.count_at is None
        end = place(leaf.offset + slot.size) if fixed else f"{at} + {slot.element_size} * {count}"
        part = f"data[{at} : {end}]"
        match type_:
            case Scalar():
                return f'values.from_numbers({part}, "{TYPECODES[type_]}", {leaf.value})'
            case String():
                return f"values.from_texts({part}, {text_out(type_, options)}, {slot.element_size})"
            case Clock():
                code = CLOCK_CODES[options.time]
                return f'values.from_clocks({part}, "{code}", {clock_out(type_, options)}, {leaf.value})'
            case _:
                assert_never(type_)

    def _pack(self, offset: int, size: int, codes: list[str], value: str, targets: list[str]) -> None:
        if not self.runs or offset - self.runs[-1].end > WIDEST_GAP:
            self.runs.append(StructRun(offset, offset))
        run = self.runs[-1]
        if offset > run.end:
            run.codes.append(f"{offset - run.end}x")
        run.codes += codes
        run.values.append(value)
        run.targets += targets
        run.end = offset + size

    def _local(self, path: str) -> str:
        """A variable for a field's path. ROS names never end with an underscore, so ours may."""
        name = python_member(path.replace(".", "_"))
        while name in self.names or name in self.class_names.values():
            name += "_"
        self.names.add(name)
        return name


class _Leaf(NamedTuple):
    """A slot at its place in the whole message: absolute offset, the expression that reads it, its path."""

    slot: Slot
    offset: int
    value: str
    path: str
    options: TypeOptions
    count_at: int | None

    @property
    def rule(self) -> str:
        return f"{'exactly' if self.count_at is None else 'at_most'}={self.slot.count}"

    @property
    def cut(self) -> str:
        return ", late" if self.options.overflow == "truncate" else ""


def place(offset: int) -> str:
    """`at + 24`, and plain `at` for 0."""
    return f"at + {offset}" if offset else "at"


def _exploded(start: str, items: list[str], end: str) -> list[str]:
    return [start, *(f"    {item}," for item in items), end]


def text_in(string: String, options: TypeOptions) -> str:
    name = "wide_text" if string.wide else {"utf-8": "text", "latin-1": "text_latin1"}[options.encoding]
    return f"values.{name}" + ("_cut" if options.overflow == "truncate" else "")


def text_out(string: String, options: TypeOptions) -> str:
    name = "from_wide" if string.wide else {"utf-8": "from_text", "latin-1": "from_latin1"}[options.encoding]
    return f"values.{name}"


def clock_in(clock: Clock, options: TypeOptions) -> str:
    signed = clock is Clock.DURATION and options.time != "struct"
    return f"values.{'duration_' if signed else ''}{_CLOCK_UNITS[options.time]}"


def clock_out(clock: Clock, options: TypeOptions) -> str:
    return f"values.{clock.value}_from_{_CLOCK_UNITS[options.time]}"
