"""Gives Python access to a compiled PLC: blocks that can be called, and variables that can be read and written."""

from __future__ import annotations

import ctypes
import pickle
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from tests.softplc.iec import Array, Elementary, Named, Pointer, Text, Type

_ELEMENTARY = {
    "BOOL": ctypes.c_uint8, "BYTE": ctypes.c_uint8, "WORD": ctypes.c_uint16, "DWORD": ctypes.c_uint32,
    "LWORD": ctypes.c_uint64, "SINT": ctypes.c_int8, "INT": ctypes.c_int16, "DINT": ctypes.c_int32,
    "LINT": ctypes.c_int64, "USINT": ctypes.c_uint8, "UINT": ctypes.c_uint16, "UDINT": ctypes.c_uint32,
    "ULINT": ctypes.c_uint64, "REAL": ctypes.c_float, "LREAL": ctypes.c_double, "TIME": ctypes.c_uint32,
    "LTIME": ctypes.c_uint64,
}  # fmt: skip
_CALL = ctypes.CFUNCTYPE(ctypes.c_char_p, ctypes.c_void_p, ctypes.c_void_p)
_MAKE = ctypes.CFUNCTYPE(None, ctypes.c_void_p)


class Trap(Exception):
    """The PLC stopped: an index is outside its bounds, a pointer is null, or a divisor is zero."""


class _Member(ctypes.Structure):
    _fields_ = (("owner", ctypes.c_char_p), ("name", ctypes.c_char_p), ("offset", ctypes.c_uint64),
                ("size", ctypes.c_uint64))  # fmt: skip


class _Kind(ctypes.Structure):
    _fields_ = (("name", ctypes.c_char_p), ("size", ctypes.c_uint64), ("make", _MAKE), ("place", ctypes.c_void_p))


class _Entry(ctypes.Structure):
    _fields_ = (("block", ctypes.c_char_p), ("method", ctypes.c_char_p), ("call", _CALL))


class _Program(ctypes.Structure):
    _fields_ = (("call", _CALL), ("self", ctypes.c_void_p))


class Plc:
    """A compiled PLC, loaded as a library. Tests set its clock and failures of its system functions (see shim.h)."""

    def __init__(self, library: ctypes.CDLL, description: tuple[Any, Any, int]) -> None:
        self.library = library
        self.types: Mapping[str, Mapping[str, Type]]
        self.enumerations: Mapping[str, Elementary]
        self.types, self.enumerations, units = description
        self.offsets: dict[str, dict[str, tuple[int, int]]] = {}
        self.sizes: dict[str, int] = {}
        self._kinds: dict[str, _Kind] = {}
        self._calls: dict[tuple[str, str], Any] = {}
        self.now = 0
        for unit in range(units):
            for member in self._table(_Member, f"members_{unit}"):
                self.offsets.setdefault(member.owner.decode(), {})[member.name.decode()] = member.offset, member.size
            for kind in self._table(_Kind, f"kinds_{unit}"):
                self._kinds[kind.name.decode()] = kind
                self.sizes[kind.name.decode()] = kind.size
            for entry in self._table(_Entry, f"entries_{unit}"):
                self._calls[entry.block.decode(), entry.method.decode()] = entry.call

    @classmethod
    def load(cls, path: Path) -> Plc:
        """Load the library that build.compile_st() has left in its folder."""
        return cls(ctypes.CDLL(str(path)), pickle.loads(path.with_suffix(".pickle").read_bytes()))

    def block(self, name: str) -> Block:
        """Return a new instance of a FUNCTION_BLOCK or a PROGRAM, with its initial values."""
        memory = self.make(name.upper())
        return Block(self, name.upper(), ctypes.addressof(memory), memory)

    def structure(self, name: str) -> View:
        """Return a new variable of a structure, with its initial values."""
        memory = self.make(name.upper())
        return View(self, name.upper(), ctypes.addressof(memory), memory)

    def globals(self, name: str) -> View:
        """Return the variables of a variable list."""
        return View(self, name.upper(), self._kinds[name.upper()].place)

    def runs(self, name: str, method: str = "") -> bool:
        """Return True if `name` is a block that has this method. Every block has the method "", its body."""
        return (name, method.upper()) in self._calls

    def make(self, name: str) -> Any:
        """Return new memory with the initial values of a structure, a block or a method's parameters."""
        kind = self._kinds[name]
        memory = (ctypes.c_uint64 * (kind.size // 8 + 1))()
        kind.make(ctypes.addressof(memory))
        return memory

    def call(self, block: str, method: str, self_: int, parameters: int) -> None:
        """Call a method of a block, or its body if `method` is "". Raises Trap if the PLC would stop."""
        reason = self._calls[block, method](self_, parameters)
        if reason:
            raise Trap(f"{block}.{method}: {reason.decode()}".replace(".:", ":"))

    def run(self, blocks: Sequence[Block], period: float, cycles: int) -> float:
        """Call all blocks in turn each `period` seconds, as a task calls its programs, without returning to Python.

        Return the duration of the longest cycle in seconds. Raises Trap.
        """
        programs = (_Program * len(blocks))(*((self._calls[block._name, ""], block._address) for block in blocks))
        reason = ctypes.c_char_p()
        run = self.library.shim_run
        run.restype = ctypes.c_uint64
        count, ns = ctypes.c_uint64(len(blocks)), ctypes.c_uint64(int(period * 1e9))
        longest = run(programs, count, ns, ctypes.c_uint64(cycles), ctypes.byref(reason))
        if reason.value:
            raise Trap(reason.value.decode())
        return float(longest) / 1e9

    def born(self, value: int) -> None:
        """Let semaphores that the PLC creates from now on begin at this value, 0 or 1."""
        self.library.shim_set_initial_value(value)

    def round_sizes(self, rounded: bool) -> None:
        """Choose whether the PLC compares sizes of shared memory exactly, or rounds the sizes up to pages first."""
        self.library.shim_round_sizes(int(rounded))

    def fail(self, function: str, result: int) -> None:
        """Let the next calls of a system function return `result`. If `result` is 0, the function works again."""
        self.library.shim_fail(function.encode(), ctypes.c_uint32(result))

    @contextmanager
    def at_each_post(self, look: Callable[[], object]) -> Iterator[None]:
        """Call `look` each time before the PLC posts a semaphore, while the `with` block runs."""
        call = ctypes.CFUNCTYPE(None)(look)
        self.library.shim_on_leave(call)
        try:
            yield
        finally:
            self.library.shim_on_leave(None)

    def set_clock(self, ms: int) -> None:
        """Stop the clock of TIME() at this value."""
        self.now = ms
        self.library.shim_stop_clock(ctypes.c_uint32(ms))

    def run_clock(self) -> None:
        """Let the clock of TIME() run again."""
        self.library.shim_restart_clock()

    @property
    def waits(self) -> int:
        """The number of times that the PLC entered a semaphore with a time limit other than 0."""
        return int(self.library.shim_waits())

    def _table(self, row: Any, name: str) -> list[Any]:
        rows = []
        address = ctypes.addressof(ctypes.c_char.in_dll(self.library, name))
        while (entry := row.from_address(address)) and getattr(entry, row._fields_[0][0]):
            rows.append(entry)
            address += ctypes.sizeof(row)
        return rows


class View:
    """The variables of a structure, a block or a variable list, as attributes. Names ignore case.

    A BOOL is a bool, a number an int or float, a TIME an int in ms, a STRING a str. An enumeration is the name of its
    value, and a pointer is an address. An array is an Elements, a structure a View, a block a Block.
    """

    def __init__(self, plc: Plc, name: str, address: int, memory: Any = None) -> None:
        self.__dict__.update(_plc=plc, _name=name, _address=address, _memory=memory)  # keep the memory alive

    def __getattr__(self, name: str) -> Any:
        type_, address = self._find(name)
        return _get(self._plc, type_, address)

    def __setattr__(self, name: str, value: Any) -> None:
        type_, address = self._find(name)
        _set(self._plc, type_, address, value)

    def bytes(self) -> bytes:
        """Return the bytes of all variables as they are in memory."""
        return ctypes.string_at(self._address, self._plc.sizes[self._name])

    def _find(self, name: str) -> tuple[Type, int]:
        types = self._plc.types[self._name]
        if name.upper() not in types:
            raise AttributeError(f"{self._name} has no {name}; it has {', '.join(types)}")
        return types[name.upper()], self._address + self._plc.offsets[self._name][name.upper()][0]


class Block(View):
    """An instance of a FUNCTION_BLOCK or a PROGRAM. A call of the object executes one cycle."""

    def __call__(self, **inputs: Any) -> Block:
        for name, value in inputs.items():
            setattr(self, name, value)
        self._plc.call(self._name, "", self._address, 0)
        return self

    @property
    def plc(self) -> Plc:
        return self._plc

    def run(self, period: float, cycles: int) -> float:
        """Call the block each `period` seconds without returning to Python. Return the seconds of the longest call."""
        return self._plc.run([self], period, cycles)

    def method(self, name: str, **inputs: Any) -> Any:
        """Call a method and return its result, or None if it has no result."""
        memory = self._plc.make(f"{self._name}.{name.upper()}")
        parameters = View(self._plc, f"{self._name}.{name.upper()}", ctypes.addressof(memory))
        for parameter, value in inputs.items():
            setattr(parameters, parameter, value)
        self._plc.call(self._name, name.upper(), self._address, ctypes.addressof(memory))
        return getattr(parameters, name) if name.upper() in self._plc.types[parameters._name] else None


class Elements:
    """The elements of an array. The indexes are those of the declaration."""

    def __init__(self, plc: Plc, type_: Array, address: int) -> None:
        self._plc, self._type, self._address = plc, type_, address

    def __len__(self) -> int:
        return self._type.last - self._type.first + 1

    def __getitem__(self, index: int) -> Any:
        return _get(self._plc, self._type.of, self._at(index))

    def __setitem__(self, index: int, value: Any) -> None:
        _set(self._plc, self._type.of, self._at(index), value)

    def __iter__(self) -> Any:
        return (self[index] for index in range(self._type.first, self._type.last + 1))

    def _at(self, index: int) -> int:
        if not self._type.first <= index <= self._type.last:
            raise IndexError(index)
        return self._address + (index - self._type.first) * size_of(self._plc, self._type.of)


def size_of(plc: Plc, type_: Type) -> int:
    """Return the size of a type in bytes."""
    match type_:
        case Elementary(name):
            return ctypes.sizeof(_ELEMENTARY[name])
        case Text(length, wide):
            return (length + 1) * (2 if wide else 1)
        case Pointer():
            return 8
        case Array(first, last, of):
            return (last - first + 1) * size_of(plc, of)
        case Named(name) if name in plc.enumerations:
            return size_of(plc, plc.enumerations[name])
        case Named(name):
            return plc.sizes[name]


def _get(plc: Plc, type_: Type, address: int) -> Any:
    match type_:
        case Elementary(name):
            value = _ELEMENTARY[name].from_address(address).value
            return bool(value) if name == "BOOL" else value
        case Text(wide=wide):
            data = ctypes.string_at(address, size_of(plc, type_))
            if wide:
                return data.decode("utf-16-le", "replace").partition("\0")[0]
            return data.partition(b"\0")[0].decode()
        case Pointer():
            return ctypes.c_uint64.from_address(address).value
        case Array():
            return Elements(plc, type_, address)
        case Named(name) if name in plc.enumerations:
            number = _get(plc, plc.enumerations[name], address)
            return next((value for value, (code, _) in plc.offsets[name].items() if code == number), number)
        case Named(name):
            return (Block if plc.runs(name) else View)(plc, name, address)


def _set(plc: Plc, type_: Type, address: int, value: Any) -> None:
    match type_:
        case Elementary(name):
            _ELEMENTARY[name].from_address(address).value = value
        case Text(length, wide):
            data = value.encode("utf-16-le") if wide else value.encode()
            assert len(data) <= length * (2 if wide else 1), f"{value!r} is longer than {type_}"
            ctypes.memmove(address, data + b"\0\0"[: 2 if wide else 1], len(data) + (2 if wide else 1))
        case Named(name) if name in plc.enumerations:
            _set(plc, plc.enumerations[name], address, plc.offsets[name][value][0])
        case Pointer():
            ctypes.c_uint64.from_address(address).value = value
        case _:
            raise TypeError(f"set the parts of {type_} one by one")
