"""Parse XML: the data types and constants in exports of PLCopen and TwinCAT, and the layouts in a .tmc file."""

from __future__ import annotations

import re
from collections.abc import Callable, Iterator
from xml.parsers import expat

from shmgen.core.diagnostics import Span
from shmgen.plc import declarations
from shmgen.plc.compiled import Compiled
from shmgen.plc.declarations import MOST, Declaration, Member, Unreadable, name, pack_mode

Part = tuple[str, list[Declaration], list[Member]]
"""A group of types and constants. The text is the name of the list that declares the constants, or `""`."""

_COMMENT = "documentation"
_LINES = ("p", "br", "li", "div")
"""Elements of XHTML that begin a new line."""
_DEEPEST = 200
"""The limit of nested elements. Exports have some twenty levels."""


def read(data: bytes, path: str, reject: Callable[[Unreadable], None]) -> Iterator[Part]:
    """Yield the data types and constants of an XML export, in groups.

    If a declaration has an error, call `reject` with the error and continue with the next declaration. Raises
    Unreadable if `data` is not XML.
    """
    for node in _Tree(data, path).root.walk():
        try:
            part = _part(node, path)
        except Unreadable as error:
            reject(error)
        else:
            if part:
                yield part


def compiled(data: bytes, path: str, file: str) -> Iterator[tuple[str, Compiled]]:
    """Yield the name and the layout of each data type in a .tmc file, except the types of libraries (with a namespace).

    The names are in capital letters. Raises Unreadable if `data` is not XML.
    """
    for node in _Tree(data, path).root.walk():
        called = node.child("Name") if node.tag == "DataType" else None
        if called and "Namespace" not in called.attributes and (size := _number(node, "BitSize")) is not None:
            items = (it for it in node if it.tag == "SubItem")
            places = ((it.child("Name"), _number(it, "BitOffs"), _number(it, "BitSize")) for it in items)
            members = {name.text.upper(): (at, bits) for name, at, bits in places if name and at is not None and bits}
            yield called.text.upper(), Compiled(file, size, members)


def _number(node: _Node, tag: str) -> int | None:
    child = node.child(tag)
    text = child.text.strip() if child else ""
    return int(text) if _DIGITS.fullmatch(text) else None


_DIGITS = re.compile(r"[0-9]{1,15}")


def _part(node: _Node, path: str) -> Part | None:
    if node.tag in ("dataType", "union"):
        plain = _plain(node)
        if plain and plain.text.strip():
            return "", *declarations.read(plain.text, path, plain.line)
        if node.tag == "dataType":
            return "", [_structured(node, path)], []
        span = Span(path, node.line)
        return "", [Declaration(name(_name(node), span), "union", (), "", "", 0, "", span)], []
    if node.tag.endswith("Vars") and node.attributes.get("constant") == "true":  # of a list, a block or a program
        return _name(node), [], [member for member in _variables(node, path) if member.value]
    if declaration := node.child("Declaration"):  # the format of TwinCAT
        return _name(node), *declarations.read(declaration.text, path, declaration.line)
    return None


class _Node:
    """An element of XML: its tag without namespace, and its line number."""

    __slots__ = ("attributes", "children", "line", "parts", "tag")

    def __init__(self, tag: str, attributes: dict[str, str], line: int) -> None:
        self.tag, self.attributes, self.line = tag.rpartition(":")[2], attributes, line
        self.children: list[_Node] = []
        self.parts: list[str] = []

    def __iter__(self) -> Iterator[_Node]:
        return iter(self.children)

    @property
    def text(self) -> str:
        return "".join(self.parts)

    def child(self, *path: str) -> _Node | None:
        here: _Node | None = self
        for tag in path:
            here = next((it for it in here if it.tag == tag), None) if here else None
        return here

    def walk(self) -> Iterator[_Node]:
        waiting = [self]
        while waiting:
            here = waiting.pop()
            yield here
            waiting += reversed(here.children)


class _Tree:
    """A tree of elements with line numbers, which only the parser expat provides.

    The constructor raises Unreadable if the data is not XML or is too large.
    """

    def __init__(self, data: bytes, path: str) -> None:
        self.root = _Node("", {}, 0)
        self._open, self._count, self._path = [self.root], 0, path
        self._parser = parser = expat.ParserCreate()
        parser.buffer_text = True
        parser.StartElementHandler = self._start
        parser.EndElementHandler = lambda tag: self._open.pop()
        parser.CharacterDataHandler = lambda text: self._holder().parts.append(text)
        parser.EntityDeclHandler = lambda *_: self._refuse("it declares entities")
        try:
            parser.Parse(data, True)
        except expat.ExpatError as error:
            place = Span(path, error.lineno, error.offset + 1)
            raise Unreadable(f"not XML: {expat.ErrorString(error.code)}", place) from None
        except (LookupError, ValueError):  # an encoding that Python or expat does not support
            raise Unreadable("not XML: unknown encoding", Span(path, 1)) from None

    def _start(self, tag: str, attributes: dict[str, str]) -> None:
        self._count += 1
        if self._count > MOST or len(self._open) > _DEEPEST:
            self._refuse(f"more than {MOST:,} elements, or more than {_DEEPEST} nested ones")
        node = _Node(tag, attributes, self._parser.CurrentLineNumber)
        self._open[-1].children.append(node)
        if node.tag in _LINES and (holder := self._holder()).tag == _COMMENT:
            holder.parts.append("\n")
        self._open.append(node)

    def _holder(self) -> _Node:
        """Return the element that receives text: the comment around the current element, else the current element."""
        return next((it for it in self._open if it.tag == _COMMENT), self._open[-1])

    def _refuse(self, why: str) -> None:
        raise Unreadable(f"not an export of an IDE: {why}", Span(self._path, self._parser.CurrentLineNumber))


def _plain(node: _Node) -> _Node | None:
    """Return the element with the plain text of a declaration, which CODESYS adds to PLCopen XML, or None.

    Only the plain text contains comments and pragmas.
    """
    for data in node.child("addData") or ():
        if data.attributes.get("name", "").endswith("/interfaceasplaintext"):
            return data.child("InterfaceAsPlainText", "xhtml")
    return None


def _name(node: _Node) -> str:
    return node.attributes.get("name") or node.attributes.get("Name", "")


def _structured(node: _Node, path: str) -> Declaration:
    """Return a data type from PLCopen's XML elements, if the export does not contain its declaration as text."""
    span, comment = Span(path, node.line), _documentation(node)
    called = name(_name(node), span)
    extends, pack, mistyped = "", 0, ""
    for data in node.child("addData") or ():
        kind = data.attributes.get("name", "").rpartition("/")[2]
        if kind == "datatypeinheritance":
            extends = next((it.text.strip() for it in data.walk() if it.tag == "Extends"), "")
        elif kind == "attributes":
            named = (it.attributes for it in data.walk() if "Name" in it.attributes)
            pack, mistyped = pack_mode((it["Name"], f"'{it.get('Value', '')}'") for it in named)
    base = node.child("baseType")
    inner = base.children[0] if base and base.children else _Node("", {}, node.line)
    if inner.tag == "struct":
        members = tuple(_variables(inner, path))
        return Declaration(called, "struct", members, "", extends, pack, comment, span, mistyped)
    if inner.tag == "enum":
        docs = {
            (it.child("Name") or it).text: (it.child("Documentation") or it).text.strip()
            for it in node.walk()
            if it.tag == "EnumValue"
        }
        values = [
            Member(
                name(_name(it), Span(path, it.line)),
                "",
                it.attributes.get("value", ""),
                docs.get(_name(it), ""),
                Span(path, it.line),
            )
            for it in inner.child("values") or ()
        ]
        over = inner.child("baseType")
        return Declaration(called, "enum", tuple(values), _type(over) if over else "", extends, pack, comment, span)
    return Declaration(called, "alias", (), _type(base) if base else "", extends, pack, comment, span)


def _variables(node: _Node, path: str) -> Iterator[Member]:
    for variable in (it for it in node if it.tag == "variable"):
        kind, value = variable.child("type"), variable.child("initialValue", "simpleValue")
        initial = value.attributes.get("value", "") if value else ""
        if not initial and variable.child("initialValue"):
            initial = "(…)"
        span, spelled = Span(path, variable.line), _type(kind) if kind else ""
        yield Member(name(_name(variable), span), spelled, initial, _documentation(variable), span)


def _documentation(node: _Node) -> str:
    """Return the text of a comment without its XHTML markup."""
    comment = node.child(_COMMENT)
    lines = (line.strip() for line in comment.text.split("\n")) if comment else ()
    return "\n".join(filter(None, lines))


def _type(node: _Node) -> str:
    """Return a type as spelled in Structured Text, with single blanks."""
    return " ".join(_spelled(node).split())


def _spelled(node: _Node) -> str:
    if not node.children:
        return ""
    inner = node.children[0]
    base = inner.child("baseType")
    element = _spelled(base) if base else ""
    match inner.tag:
        case "derived":
            return _name(inner)
        case "array":
            bounds = [
                f"{it.attributes.get('lower')}..{it.attributes.get('upper')}" for it in inner if it.tag == "dimension"
            ]
            return f"ARRAY[{', '.join(bounds)}] OF {element}"
        case "string" | "wstring":
            length = inner.attributes.get("length")
            return f"{inner.tag.upper()}({length})" if length else inner.tag.upper()
        case "pointer" | "reference":
            return f"{inner.tag.upper()} TO {element}"
        case "subrangeSigned" | "subrangeUnsigned":
            return element
        case other:
            return other
