"""What differs between the two open compilers: how a type is spelled, and how C reaches a variable of the program's."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from typing import NamedTuple

from shmgen.core.model import Clock, Element, Ref, Scalar, Slot, String, TypeOptions, assert_never
from shmgen.targets.openplc.names import whole
from shmgen.targets.st import names as st

NS_PER_MS = 1_000_000


class Compiler(NamedTuple):
    """Each function gives a piece of C, or of Structured Text; `longest` is the number of characters of a text.

    Of the block's variables, by their names: `text` the type of a text of so many characters, in an array or not; `get`
    the value of an elementary one, `put` the statement that gives it one; `structure` one that is a structure; `topic`
    a statement, and then the text of a variable and its length; `ns` a TIME in ns; `owner` what tells one block from
    another, its address. Of what the program holds: `element` of an array, the `value` of a member, `time_in` the
    statement that gives it a TIME of the message in ms, `time_out` a TIME in ms, `text_in` and `text_out` the same of
    texts, the latter with a capacity.
    """

    title: str
    longest: int
    owner: str
    text: Callable[[int, bool], str]
    get: Callable[[str], str]
    put: Callable[[str, str], str]
    structure: Callable[[str], str]
    topic: Callable[[str], tuple[str, str, str]]
    ns: Callable[[str], str]
    element: Callable[[str, str], str]
    value: Callable[[str], str]
    time_in: Callable[[str, str], str]
    time_out: Callable[[str], str]
    text_in: Callable[[str, str], str]
    text_out: Callable[[str, str, int], str]

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
                return self.text(capacity, in_array)
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


def _matiec_topic(variable: str) -> tuple[str, str, str]:
    text = f"data__->{variable}.value"
    return "", f"(const char *){text}.body", f"(size_t)({text}.len > 0 ? {text}.len : 0)"


MATIEC = Compiler(
    title="matiec",
    longest=126,
    owner="data__",
    text=lambda capacity, in_array: "STRING",
    get="data__->{}.value".format,
    put="data__->{}.value = {};".format,
    structure="data__->{}.value".format,
    topic=_matiec_topic,
    ns="(int64_t)data__->{0}.value.tv_sec * 1000000000 + data__->{0}.value.tv_nsec".format,
    element="{}.table[{}]".format,
    value=str,
    time_in=f"{{0}}.tv_sec = {{1}} / 1000; {{0}}.tv_nsec = {{1}} % 1000 * {NS_PER_MS};".format,
    time_out=f"(int64_t){{0}}.tv_sec * 1000 + {{0}}.tv_nsec / {NS_PER_MS}".format,
    text_in="{0}.len = shmgen_text_in({0}.body, sizeof {0}.body, {1});".format,
    text_out="shmgen_text_out({1}, {2}, {0}.body, (size_t)({0}.len > 0 ? {0}.len : 0));".format,
)
"""A block's data is `data__`, each variable a structure of value and flags, and within it all is plain C."""
STRUCPP = Compiler(
    title="OpenPLC",
    longest=254,
    owner="this",
    text=lambda capacity, in_array: "STRING" if in_array else f"STRING({capacity})",
    get="{}.get()".format,
    put="{} = {};".format,
    structure=str,
    topic=lambda variable: (f"const auto text = {variable}.get();", "text.c_str()", "text.length()"),
    ns="(int64_t){}.get()".format,
    element="{}[{}]".format,
    value="{}.get()".format,
    time_in=f"{{}} = (int64_t){{}} * {NS_PER_MS};".format,
    time_out=f"{{}}.get() / {NS_PER_MS}".format,
    text_in="{} = {};".format,
    text_out="{{ const auto text = {0}.get(); shmgen_text_out({1}, {2}, text.c_str(), text.length()); }}".format,
)
"""A block is a class; each elementary value in it is wrapped, so that a debugger can force it."""
