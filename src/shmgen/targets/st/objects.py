"""Define the Structured Text objects that an IDE stores: data types, variable lists, blocks and programs with methods.

The target st plans and renders these objects. The targets that convert the output of st use the same objects.
"""

from __future__ import annotations

from typing import NamedTuple


class Attribute(NamedTuple):
    """An attribute pragma: `{attribute 'name' := 'value'}`, or `{attribute 'name'}` if `value` is empty."""

    name: str
    value: str = ""

    @property
    def text(self) -> str:
        """The pragma in Structured Text."""
        return f"{{attribute '{self.name}' := '{self.value}'}}" if self.value else f"{{attribute '{self.name}'}}"


class Head(NamedTuple):
    """The head of an object: the lines of its comment, which begin with `//`, and its attributes."""

    comment: tuple[str, ...]
    attributes: tuple[Attribute, ...] = ()


class Variable(NamedTuple):
    """A declaration of a variable, a structure's member or an enumeration's name: `name : type := value;`.

    The name of an enumeration has no type. The value of an array is a tuple with the value of each element, which
    becomes `[1, 2]`. Each line of the comment begins with `//`.
    """

    name: str
    type: str
    value: str | tuple[str, ...] = ""
    comment: tuple[str, ...] = ()

    def code(self, width: int) -> str:
        """Return the declaration in Structured Text, with the name padded to `width` characters."""
        value = self.value if isinstance(self.value, str) else f"[{', '.join(self.value)}]"
        return f"{self.name:<{width}} : {self.type}{value and f' := {value}'};"


class Variables(NamedTuple):
    """One section of variables. `keyword` is VAR, VAR_INPUT, VAR_OUTPUT or VAR_GLOBAL."""

    keyword: str
    constant: bool
    variables: tuple[Variable, ...]

    @property
    def text(self) -> str:
        """The first line of the section, such as `VAR_GLOBAL CONSTANT`."""
        return f"{self.keyword} CONSTANT" if self.constant else self.keyword


class DataType(NamedTuple):
    """A structure, an enumeration over the type `base`, or an alias of the type `alias`.

    `initial` is the initial value of an enumeration's variables, or `""`.
    """

    name: str
    head: Head
    members: tuple[Variable, ...]
    base: str = ""
    initial: str = ""
    alias: str = ""


class GlobalList(NamedTuple):
    """A list of global variables or constants."""

    name: str
    head: Head
    variables: Variables


class Unit(NamedTuple):
    """A function block, a program or a method. `keyword` is FUNCTION_BLOCK, PROGRAM or METHOD.

    `access` is PUBLIC, PRIVATE or `""`. `returns` is the type of a method's result, or `""`. The text in the file
    consists of `declaration`, `body`, and a last line such as END_METHOD.
    """

    keyword: str
    name: str
    access: str
    returns: str
    head: Head
    sections: tuple[Variables, ...]
    declaration: str
    body: str
    methods: tuple[Unit, ...] = ()


# --- Views for the templates ----------------------------------------------------------------------------


class Line(NamedTuple):
    """A line with a declaration and the comment beside it. `above` contains the comment lines above the line."""

    text: str
    above: tuple[str, ...] = ()


class Dut(NamedTuple):
    """The template data for a data type."""

    object: DataType
    members: tuple[Line, ...]


class Gvl(NamedTuple):
    """The template data for a variable list.

    A blank line separates shmgen's variables (`generated`) from the user's (`declared`).
    """

    object: GlobalList
    generated: tuple[Line, ...]
    declared: tuple[Line, ...] = ()
