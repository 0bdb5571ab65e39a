"""Reads the data types and constants in exports in XML, PLCopen's and TwinCAT's own."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from xml.parsers import expat

from shmgen.core.diagnostics import Span
from shmgen.plc import declarations
from shmgen.plc.declarations import MOST, Declared, Member, Unreadable, name, pack_mode

Part = tuple[str, list[Declared], list[Member]]
"""The list that constants stand in, types, constants."""

_DEEPEST = 200
"""Elements in each other; exports have some twenty."""


def read(data: bytes, path: str, tell: Callable[[Unreadable], None]) -> Iterator[Part]:
    """`tell` hears of a declaration that is left out. Raises Unreadable if there is no XML."""
    for node in _Tree(data, path).root.walk():
        try:
            part = _part(node, path)
        except Unreadable as error:
            tell(error)
        else:
            if part:
                yield part


def _part(node: _Node, path: str) -> Part | None:
    if node.tag in ("dataType", "union"):
        plain = _plain(node)
        if plain and plain.text.strip():
            return "", *declarations.read(plain.text, path, plain.line)
        if node.tag == "dataType":
            return "", [_structured(node, path)], []
        span = Span(path, node.line)
        return "", [Declared(name(_name(node), span), "union", (), "", "", 0, "", span)], []
    if node.tag.endswith("Vars") and node.attributes.get("constant") == "true":  # of a list, a block or a program
        return _name(node), [], [member for member in _variables(node, path) if member.value]
    if declaration := node.child("Declaration"):  # of TwinCAT
        return _name(node), *declarations.read(declaration.text, path, declaration.line)
    return None


class _Node:
    """An element, without its namespace, and the line where it stands."""

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
    """expat, as it alone tells lines. Raises Unreadable."""

    def __init__(self, data: bytes, path: str) -> None:
        self.root = _Node("", {}, 0)
        self._open, self._count, self._path = [self.root], 0, path
        self._parser = parser = expat.ParserCreate()
        parser.buffer_text = True
        parser.StartElementHandler = self._start
        parser.EndElementHandler = lambda tag: self._open.pop()
        parser.CharacterDataHandler = lambda text: self._open[-1].parts.append(text)
        parser.EntityDeclHandler = lambda *_: self._refuse("it declares entities")
        try:
            parser.Parse(data, True)
        except expat.ExpatError as error:
            place = Span(path, error.lineno, error.offset + 1)
            raise Unreadable(f"not XML: {expat.ErrorString(error.code)}", place) from None
        except (LookupError, ValueError):  # an encoding that Python, or expat, does not know
            raise Unreadable("not XML: unknown encoding", Span(path, 1)) from None

    def _start(self, tag: str, given: dict[str, str]) -> None:
        self._count += 1
        if self._count > MOST or len(self._open) > _DEEPEST:
            self._refuse(f"more than {MOST:,} elements, or {_DEEPEST} in each other")
        node = _Node(tag, given, self._parser.CurrentLineNumber)
        self._open[-1].children.append(node)
        self._open.append(node)

    def _refuse(self, why: str) -> None:
        raise Unreadable(f"no export of an IDE: {why}", Span(self._path, self._parser.CurrentLineNumber))


def _plain(node: _Node) -> _Node | None:
    """CODESYS's own text of a declaration, which alone holds comments and pragmas, if the export has it."""
    for data in node.child("addData") or ():
        if data.attributes.get("name", "").endswith("/interfaceasplaintext"):
            return data.child("InterfaceAsPlainText", "xhtml")
    return None


def _name(node: _Node) -> str:
    return node.attributes.get("name") or node.attributes.get("Name", "")


def _structured(node: _Node, path: str) -> Declared:
    """A data type in PLCopen's own words."""
    span, comment = Span(path, node.line), _documentation(node)
    called = name(_name(node), span)
    extends, pack = "", 0
    for data in node.child("addData") or ():
        kind = data.attributes.get("name", "").rpartition("/")[2]
        if kind == "datatypeinheritance":
            extends = next((it.text.strip() for it in data.walk() if it.tag == "Extends"), "")
        elif kind == "attributes":
            modes = [it.attributes.get("Value", "") for it in data.walk() if it.attributes.get("Name") == "pack_mode"]
            pack = pack_mode(modes[0]) if modes else 0
    base = node.child("baseType")
    inner = base.children[0] if base and base.children else _Node("", {}, node.line)
    if inner.tag == "struct":
        return Declared(called, "struct", tuple(_variables(inner, path)), "", extends, pack, comment, span)
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
        return Declared(called, "enum", tuple(values), _type(over) if over else "", extends, pack, comment, span)
    return Declared(called, "alias", (), _type(base) if base else "", extends, pack, comment, span)


def _variables(node: _Node, path: str) -> Iterator[Member]:
    for variable in (it for it in node if it.tag == "variable"):
        kind, value = variable.child("type"), variable.child("initialValue", "simpleValue")
        initial = value.attributes.get("value", "") if value else ""
        if not initial and variable.child("initialValue"):
            initial = "(…)"
        span, spelled = Span(path, variable.line), _type(kind) if kind else ""
        yield Member(name(_name(variable), span), spelled, initial, _documentation(variable), span)


def _documentation(node: _Node) -> str:
    text = node.child("documentation", "xhtml")
    return "\n".join(line.strip() for line in text.text.strip().split("\n")) if text else ""


def _type(node: _Node) -> str:
    """As Structured Text spells it, with single blanks."""
    return " ".join(_spelled(node).split())


def _spelled(node: _Node) -> str:
    inner = node.children[0] if node.children else None
    if inner is None:
        return ""
    match inner.tag:
        case "derived":
            return _name(inner)
        case "array":
            bounds = [
                f"{it.attributes.get('lower')}..{it.attributes.get('upper')}" for it in inner if it.tag == "dimension"
            ]
            element = inner.child("baseType")
            return f"ARRAY[{', '.join(bounds)}] OF {_spelled(element) if element else ''}"
        case "string" | "wstring":
            length = inner.attributes.get("length")
            return f"{inner.tag.upper()}({length})" if length else inner.tag.upper()
        case "pointer" | "reference":
            element = inner.child("baseType")
            return f"{inner.tag.upper()} TO {_spelled(element) if element else ''}"
        case "subrangeSigned" | "subrangeUnsigned":
            element = inner.child("baseType")
            return _spelled(element) if element else ""
        case other:
            return other
