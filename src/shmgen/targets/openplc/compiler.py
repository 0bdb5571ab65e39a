"""Describe the differences between the open compilers STruC++ and matiec.

The two compilers spell types differently. C code also accesses the variables of a program differently.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from typing import NamedTuple

from shmgen.core.diagnostics import Report
from shmgen.core.model import Clock, Element, Layouts, Ref, Scalar, Slot, String, TypeOptions
from shmgen.targets.openplc.names import whole
from shmgen.targets.st import names as st

NS_PER_MS = 1_000_000


class Compiler(NamedTuple):
    """One of the two open compilers: the pieces of C and of Structured Text in which they differ.

    * `longest`: the largest capacity of a STRING in bytes.
    * `owner`: the C expression for a block's address, which identifies the block.
    * `text`: the STRING type for a capacity. The second argument is True for the elements of an array.

    Five functions take the name of a block's variable and return C:

    * `get`: the value of an elementary variable. `put`: the statement that assigns a value.
    * `structure`: a variable that is a structure. `ns`: a TIME in nanoseconds.
    * `topic`: for a STRING, a statement to run first, and the expressions for the text and the length.

    Six functions take a C expression for a value in the program:

    * `element`: an element of an array. `value`: the value of a member.
    * `time_in`: the statement that assigns a TIME in milliseconds. `time_out`: a TIME in milliseconds.
    * `text_in`: the statement that copies a string from the message to the program.
    * `text_out`: the statement that copies a string from the program to the message, up to a capacity.
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
        """Return the statement that copies the field `c` of the message to the variable `plc` of the program."""
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
        """Return the statement that copies the variable `plc` of the program to the field `c` of the message."""
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
        """Return the Structured Text name of a type. `in_array` is true for the type of an array's elements."""
        match type_:
            case String(capacity, _):
                assert capacity is not None, "bounds come before targets"
                return self.text(capacity, in_array)
            case Ref(name):
                return whole(st.st_type(name))
            case _:
                return st.iec_element(type_, options)

    def declared(self, slot: Slot, options: TypeOptions) -> str:
        """Return the declared type of a member, such as `ARRAY[0..35] OF LREAL`."""
        element = self.spelled(slot.type, options, in_array=slot.count is not None)
        return element if slot.count is None else f"ARRAY[0..{slot.count - 1}] OF {element}"

    def check(self, layouts: Layouts, key: str, report: Report) -> None:
        """Report SHM305 for each field that the compiler cannot represent. `key` is the target's key."""
        for layout in layouts.values():
            for slot in layout.slots:
                fault, hint = self._fault(slot.type, layout.options)
                if fault and slot.field and not report.is_enough(slot.field.span.path):
                    hint = f'{hint}, or remove "{key}" from `targets` in shmgen.toml'
                    span, where = slot.field.span.at(slot.field.name), f"{layout.name.short}.{slot.name}"
                    report.error("SHM305", f"{fault} {self.title}", span, field=where, hint=hint)

    def _fault(self, type_: Element, options: TypeOptions) -> tuple[str, str]:
        """Return the reason why the compiler cannot represent a type, and a hint, or two empty strings."""
        match type_:
            case String(wide=True):
                return "WSTRING does not exist in", "change the type to `string` in the definition"
            case String(capacity, _) if (capacity or 0) > self.longest:
                most = f"{self.longest} bytes"
                return f"{capacity} bytes are more than {most}, the limit of a STRING in", f"lower the bound to {most}"
            case Clock() if options.time == "LTIME":
                return "LTIME does not exist in", 'set time = "TIME" or "struct" in shmgen.toml'
        return "", ""

    def _seconds(self, plc: str, c: str) -> Iterator[tuple[str, str]]:
        """Yield the pairs of members to copy between the time `plc` of the program and the time `c` of the message."""
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
"""The fragments for matiec. `data__` is a block's data; each variable is a C structure of value and flags."""
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
"""The fragments for STruC++. A block is a class with wrapped elementary values, so that a debugger can force them."""
