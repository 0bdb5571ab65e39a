"""What differs between the two open compilers: how a type is spelled, and how C reaches a variable of the program's."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Iterator

from shmgen.core.model import Clock, Element, Ref, Scalar, Slot, String, TypeOptions, assert_never
from shmgen.targets.openplc.names import whole
from shmgen.targets.st import names as st

NS_PER_MS = 1_000_000


class Compiler(ABC):
    """`longest` is the number of characters that a text may have."""

    title: str
    longest: int
    owner: str
    """What tells one function block from another: its address."""

    @abstractmethod
    def text(self, capacity: int, *, in_array: bool) -> str:
        """The type of a text."""

    @abstractmethod
    def get(self, variable: str) -> str:
        """The value of the block's variable, of an elementary type."""

    @abstractmethod
    def put(self, variable: str, value: str) -> str:
        """The statement that gives it one."""

    @abstractmethod
    def structure(self, variable: str) -> str:
        """The block's variable that is a structure."""

    @abstractmethod
    def topic(self, variable: str) -> tuple[str, str, str]:
        """A statement, and then the text of a variable and its length."""

    @abstractmethod
    def ns(self, variable: str) -> str:
        """A TIME in ns."""

    @abstractmethod
    def element(self, array: str, index: str) -> str: ...

    @abstractmethod
    def value(self, plc: str) -> str:
        """The value of a member of the program's, of an elementary type."""

    @abstractmethod
    def time_in(self, plc: str, c: str) -> str:
        """The statement that gives a TIME of the message, in ms, to the program."""

    @abstractmethod
    def time_out(self, plc: str) -> str:
        """A TIME of the program's in ms."""

    @abstractmethod
    def text_in(self, plc: str, c: str) -> str:
        """The statement that gives a text of the message to the program."""

    @abstractmethod
    def text_out(self, plc: str, c: str, capacity: int) -> str:
        """The other way round."""

    def leaf_in(self, plc: str, c: str, type_: Element, options: TypeOptions) -> str:
        """The statement that gives a value of the message to the program."""
        match type_:
            case Clock() if options.time == "struct":
                return " ".join(f"{one} = {other};" for one, other in self._seconds(plc, c))
            case Clock():
                return self.time_in(plc, c)
            case String():
                return self.text_in(plc, c)
            case Scalar.BOOL:
                return f"{plc} = {c} != 0;"
            case _:
                return f"{plc} = {c};"

    def leaf_out(self, plc: str, c: str, type_: Element, options: TypeOptions) -> str:
        """The other way round."""
        match type_:
            case Clock() if options.time == "struct":
                return " ".join(f"{other} = {self.value(one)};" for one, other in self._seconds(plc, c))
            case Clock():
                return f"{c} = (uint32_t)({self.time_out(plc)});"
            case String(capacity, _):
                assert capacity is not None, "bounds come before targets"
                return self.text_out(plc, c, capacity)
            case Scalar.BOOL:
                return f"{c} = {self.value(plc)} != 0;"
            case _:
                return f"{c} = {self.value(plc)};"

    def spelled(self, type_: Element, options: TypeOptions, *, in_array: bool = False) -> str:
        """As Structured Text spells the type of a member or of an element of one."""
        match type_:
            case Scalar.BOOL:
                return options.bool
            case Scalar():
                return type_.iec
            case Clock():
                return st.ST_TIME if options.time == "struct" else "TIME"
            case String(capacity, _):
                assert capacity is not None, "bounds come before targets"
                return self.text(capacity, in_array=in_array)
            case Ref(name):
                return whole(st.st_type(name))
            case _:
                assert_never(type_)

    def declared(self, slot: Slot, options: TypeOptions) -> str:
        """`ARRAY[0..35] OF LREAL`."""
        element = self.spelled(slot.type, options, in_array=slot.count is not None)
        return element if slot.count is None else f"ARRAY[0..{slot.count - 1}] OF {element}"

    def _seconds(self, plc: str, c: str) -> Iterator[tuple[str, str]]:
        """The members of a time that is a structure, and those of the C structure."""
        yield f"{plc}.DISEC", f"{c}.sec"
        yield f"{plc}.UDINANOSEC", f"{c}.nanosec"


class Matiec(Compiler):
    """A block's data is `data__`, each variable a structure of value and flags, and within it all is plain C."""

    title = "matiec"
    longest = 126
    owner = "data__"

    def text(self, capacity: int, *, in_array: bool) -> str:
        return "STRING"

    def get(self, variable: str) -> str:
        return f"data__->{variable}.value"

    def put(self, variable: str, value: str) -> str:
        return f"data__->{variable}.value = {value};"

    def structure(self, variable: str) -> str:
        return self.get(variable)

    def topic(self, variable: str) -> tuple[str, str, str]:
        text = self.get(variable)
        return "", f"(const char *){text}.body", f"(size_t)({text}.len > 0 ? {text}.len : 0)"

    def ns(self, variable: str) -> str:
        time = self.get(variable)
        return f"(int64_t){time}.tv_sec * 1000000000 + {time}.tv_nsec"

    def element(self, array: str, index: str) -> str:
        return f"{array}.table[{index}]"

    def value(self, plc: str) -> str:
        return plc

    def time_in(self, plc: str, c: str) -> str:
        return f"{plc}.tv_sec = {c} / 1000; {plc}.tv_nsec = {c} % 1000 * {NS_PER_MS};"

    def time_out(self, plc: str) -> str:
        return f"(int64_t){plc}.tv_sec * 1000 + {plc}.tv_nsec / {NS_PER_MS}"

    def text_in(self, plc: str, c: str) -> str:
        return f"{plc}.len = shmgen_text_in({plc}.body, sizeof {plc}.body, {c});"

    def text_out(self, plc: str, c: str, capacity: int) -> str:
        length = f"(size_t)({plc}.len > 0 ? {plc}.len : 0)"
        return f"shmgen_text_out({c}, {capacity}, {plc}.body, {length});"


class Strucpp(Compiler):
    """A block is a class; each elementary value in it is wrapped, so that a debugger can force it."""

    title = "OpenPLC"
    longest = 254
    owner = "this"

    def text(self, capacity: int, *, in_array: bool) -> str:
        return "STRING" if in_array else f"STRING({capacity})"

    def get(self, variable: str) -> str:
        return f"{variable}.get()"

    def put(self, variable: str, value: str) -> str:
        return f"{variable} = {value};"

    def structure(self, variable: str) -> str:
        return variable

    def topic(self, variable: str) -> tuple[str, str, str]:
        return f"const auto text = {variable}.get();", "text.c_str()", "text.length()"

    def ns(self, variable: str) -> str:
        return f"(int64_t){variable}.get()"

    def element(self, array: str, index: str) -> str:
        return f"{array}[{index}]"

    def value(self, plc: str) -> str:
        return f"{plc}.get()"

    def time_in(self, plc: str, c: str) -> str:
        return f"{plc} = (int64_t){c} * {NS_PER_MS};"

    def time_out(self, plc: str) -> str:
        return f"{plc}.get() / {NS_PER_MS}"

    def text_in(self, plc: str, c: str) -> str:
        return f"{plc} = {c};"

    def text_out(self, plc: str, c: str, capacity: int) -> str:
        copy = f"shmgen_text_out({c}, {capacity}, text.c_str(), text.length());"
        return f"{{ const auto text = {plc}.get(); {copy} }}"


MATIEC = Matiec()
STRUCPP = Strucpp()
