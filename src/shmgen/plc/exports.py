"""Parse XML: the data types and constants in exports of PLCopen and TwinCAT, and the layouts in a .tmc file."""

from __future__ import annotations

import re
from collections.abc import Callable, Iterator
from typing import NoReturn
from xml.etree.ElementTree import Element, TreeBuilder
from xml.parsers import expat

from shmgen.core.diagnostics import Span
from shmgen.plc import declarations
from shmgen.plc.compiled import Compiled
from shmgen.plc.declarations import MOST, Declaration, Member, Unreadable, name, pack_mode

Part = tuple[str, list[Declaration], list[Member]]
"""A group of types and constants. The text is the name of the list that declares the constants, or `""`."""

_LINES = ("p", "br", "li", "div")
"""Elements of XHTML that begin a new line."""
_LINE_NUMBER = "line number"
"""The attribute with the line number of an element. XML allows no blank in a name, so no file has this attribute."""
_DEEPEST = 200
"""The limit of nested elements. Exports have some twenty levels."""


def read(data: bytes, path: str, reject: Callable[[Unreadable], None]) -> Iterator[Part]:
    """Yield the data types and constants of an XML export, in groups.

    If a declaration has an error, call `reject` with the error and continue with the next declaration. Raises
    Unreadable if `data` is not XML.
    """
    for node in _parse(data, path).iter():
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
    for node in _parse(data, path).iter("DataType"):
        called, size = node.find("Name"), _number(node, "BitSize")
        if called is not None and "Namespace" not in called.attrib and size is not None:
            items = node.iterfind("SubItem")
            places = ((it.findtext("Name"), _number(it, "BitOffs"), _number(it, "BitSize")) for it in items)
            members = {name.upper(): (at, bits) for name, at, bits in places if name and at is not None and bits}
            yield _text(called).upper(), Compiled(file, size, members)


def _number(node: Element, tag: str) -> int | None:
    text = node.findtext(tag, "").strip()
    return int(text) if _DIGITS.fullmatch(text) else None


_DIGITS = re.compile(r"[0-9]{1,15}")


def _part(node: Element, path: str) -> Part | None:
    if node.tag in ("dataType", "union"):
        plain = _plain(node)
        if plain is not None and (text := _text(plain)).strip():
            return "", *declarations.read(text, path, _span(plain, path).line)
        if node.tag == "dataType":
            return "", [_parse_type(node, path)], []
        span = _span(node, path)
        return "", [Declaration(name(_name(node), span), "union", (), "", "", 0, "", span)], []
    if node.tag.endswith("Vars") and node.get("constant") == "true":  # of a list, a block or a program
        return _name(node), [], [member for member in _variables(node, path) if member.value]
    if (declaration := node.find("Declaration")) is not None:  # the format of TwinCAT
        return _name(node), *declarations.read(_text(declaration), path, _span(declaration, path).line)
    return None


def _parse(data: bytes, path: str) -> Element:
    """Parse XML into elements with tags without namespace and with line numbers, which only the parser expat provides.

    Raises Unreadable if the data is not XML or is too large.
    """
    parser, builder = expat.ParserCreate(), TreeBuilder()
    count = depth = 0

    def refuse(why: str) -> NoReturn:
        raise Unreadable(f"not an export of an IDE: {why}", Span(path, parser.CurrentLineNumber))

    def start(tag: str, attributes: dict[str, str]) -> None:
        nonlocal count, depth
        count, depth = count + 1, depth + 1
        if count > MOST or depth > _DEEPEST:
            refuse(f"more than {MOST:,} elements, or more than {_DEEPEST} nested ones")
        bare = tag.rpartition(":")[2]
        if bare in _LINES:
            builder.data("\n")
        builder.start(bare, attributes | {_LINE_NUMBER: str(parser.CurrentLineNumber)})

    def end(tag: str) -> None:
        nonlocal depth
        depth -= 1
        builder.end(tag)

    parser.buffer_text = True
    parser.StartElementHandler, parser.EndElementHandler, parser.CharacterDataHandler = start, end, builder.data
    parser.EntityDeclHandler = lambda *_: refuse("it declares entities")
    try:
        parser.Parse(data, True)
    except expat.ExpatError as error:
        place = Span(path, error.lineno, error.offset + 1)
        raise Unreadable(f"not XML: {expat.ErrorString(error.code)}", place) from None
    except (LookupError, ValueError):  # an encoding that Python or expat does not support
        raise Unreadable("not XML: unknown encoding", Span(path, 1)) from None
    return builder.close()


def _span(node: Element, path: str) -> Span:
    return Span(path, int(node.attrib[_LINE_NUMBER]))


def _text(node: Element) -> str:
    return "".join(node.itertext())


def _plain(node: Element) -> Element | None:
    """Return the element with the plain text of a declaration, which CODESYS adds to PLCopen XML, or None.

    Only the plain text contains comments and pragmas.
    """
    for data in node.iterfind("addData/*"):
        if data.get("name", "").endswith("/interfaceasplaintext"):
            return data.find("InterfaceAsPlainText/xhtml")
    return None


def _name(node: Element) -> str:
    return node.get("name", "") or node.get("Name", "")


def _parse_type(node: Element, path: str) -> Declaration:
    """Return a data type from PLCopen's XML elements, if the export does not contain its declaration as text."""
    span, comment = _span(node, path), _documentation(node)
    called = name(_name(node), span)
    extends, pack, mistyped = "", 0, ""
    for data in node.iterfind("addData/*"):
        kind = data.get("name", "").rpartition("/")[2]
        if kind == "datatypeinheritance":
            extends = next((_text(it).strip() for it in data.iter("Extends")), "")
        elif kind == "attributes":
            named = (it.attrib for it in data.iter() if "Name" in it.attrib)
            pack, mistyped = pack_mode((it["Name"], f"'{it.get('Value', '')}'") for it in named)
    if (struct := node.find("baseType/struct")) is not None:
        members = tuple(_variables(struct, path))
        return Declaration(called, "struct", members, "", extends, pack, comment, span, mistyped)
    if (enum := node.find("baseType/enum")) is not None:
        docs = {it.findtext("Name"): it.findtext("Documentation", "").strip() for it in node.iter("EnumValue")}
        members = tuple(_enumerator(it, path, docs.get(_name(it), "")) for it in enum.iterfind("values/*"))
        return Declaration(called, "enum", members, _type(enum.find("baseType")), extends, pack, comment, span)
    return Declaration(called, "alias", (), _type(node.find("baseType")), extends, pack, comment, span)


def _enumerator(node: Element, path: str, comment: str) -> Member:
    span = _span(node, path)
    return Member(name(_name(node), span), "", node.get("value", ""), comment, span)


def _variables(node: Element, path: str) -> Iterator[Member]:
    for variable in node.iterfind("variable"):
        value, simple = variable.find("initialValue"), variable.find("initialValue/simpleValue")
        initial = simple.get("value", "") if simple is not None else ""
        if not initial and value is not None:
            initial = "(…)"
        span = _span(variable, path)
        own_name, type_ = name(_name(variable), span), _type(variable.find("type"))
        yield Member(own_name, type_, initial, _documentation(variable), span)


def _documentation(node: Element) -> str:
    """Return the text of a comment without its XHTML markup."""
    comment = node.find("documentation")
    lines = (line.strip() for line in _text(comment).split("\n")) if comment is not None else ()
    return "\n".join(filter(None, lines))


def _type(node: Element | None) -> str:
    """Return a type as spelled in Structured Text, with single blanks."""
    return " ".join(_type_text(node).split())


def _type_text(node: Element | None) -> str:
    inner = node.find("*") if node is not None else None
    if inner is None:
        return ""
    element = _type_text(inner.find("baseType"))
    match inner.tag:
        case "derived":
            return _name(inner)
        case "array":
            bounds = [f"{it.get('lower')}..{it.get('upper')}" for it in inner.iterfind("dimension")]
            return f"ARRAY[{', '.join(bounds)}] OF {element}"
        case "string" | "wstring":
            length = inner.get("length")
            return f"{inner.tag.upper()}({length})" if length else inner.tag.upper()
        case "pointer" | "reference":
            return f"{inner.tag.upper()} TO {element}"
        case "subrangeSigned" | "subrangeUnsigned":
            return element
        case other:
            return other
