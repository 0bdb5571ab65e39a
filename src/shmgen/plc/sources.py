"""Turns files of a PLC project into the data types that they declare: PLCopen XML, .TcDUT and .TcGVL, and plain .st."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from pathlib import Path
from xml.parsers import expat

from shmgen.core.diagnostics import Report, Span
from shmgen.plc import declarations
from shmgen.plc.declarations import Declared, Member, Unreadable

SUFFIXES = (".xml", ".st", ".tcdut", ".tcgvl")
LARGEST_FILE = 64 * 2**20
"""Bytes; the largest export of a whole project that is known to us has 12 MiB."""


class Project:
    """The types in order, and the constants that bounds may name."""

    def __init__(self) -> None:
        self.types: list[Declared] = []
        self.constants: dict[str, str] = {}

    def take(self, types: Iterable[Declared], constants: dict[str, str]) -> None:
        """A type that is there already, as in the export of one application beside another, counts once."""
        known = {it.name.upper() for it in self.types}
        for it in types:
            if it.name.upper() not in known:
                known.add(it.name.upper())
                self.types.append(it)
        self.constants |= constants


def read(paths: Iterable[Path], report: Report) -> Project:
    """Of files, and of folders with all that is below them. SHM001, SHM002 and SHM003 in the report."""
    project = Project()
    for path in paths:
        found = _below(path)
        if not found:
            hint = f"give a file or a folder with {', '.join(SUFFIXES)}"
            report.error(
                "SHM001", "no such file" if not path.exists() else "nothing to import", Span(str(path)), hint=hint
            )
        for file in found:
            _read(file, file.as_posix(), project, report)
    return project


def _below(path: Path) -> list[Path]:
    if path.is_dir():
        return sorted(it for it in path.rglob("*") if it.suffix.lower() in SUFFIXES and it.is_file())
    return [path] if path.is_file() else []


def _read(file: Path, shown: str, project: Project, report: Report) -> None:
    try:
        data = file.read_bytes()
        if len(data) > LARGEST_FILE:
            report.error("SHM001", f"larger than {LARGEST_FILE >> 20} MiB", Span(shown))
            return
        if data.lstrip(b"\xef\xbb\xbf \t\r\n").startswith(b"<"):
            for types, constants in _xml(_Tree(data).root, shown):
                project.take(types, constants)
        else:
            project.take(*declarations.read(_decoded(data), shown))
    except OSError as error:
        report.error("SHM001", f"cannot read: {error.strerror}", Span(shown))
    except expat.ExpatError as error:
        place = Span(shown, error.lineno, error.offset + 1)
        report.error("SHM003", f"not XML: {expat.ErrorString(error.code)}", place, hint="export it again")
    except Unreadable as error:
        report.error("SHM003", error.message, error.span, hint="is it a declaration that your IDE compiles?")


def _decoded(data: bytes) -> str:
    """As IDEs save: UTF-8, or the code page of western Windows."""
    try:
        return data.decode("utf-8-sig").replace("\r\n", "\n")
    except UnicodeDecodeError:
        return data.decode("cp1252", errors="replace").replace("\r\n", "\n")


class _Node:
    """An element, without its namespace, and the line where it stands."""

    def __init__(self, tag: str, attributes: dict[str, str], line: int) -> None:
        self.tag, self.attributes, self.line = tag.rpartition(":")[2], attributes, line
        self.children: list[_Node] = []
        self.text = ""

    def __iter__(self) -> Iterator[_Node]:
        return iter(self.children)

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
    """expat, as it alone tells lines. What an entity stands for is not looked up."""

    def __init__(self, data: bytes) -> None:
        self.root = _Node("", {}, 0)
        self._open = [self.root]
        parser = expat.ParserCreate()
        parser.StartElementHandler = lambda tag, given: self._start(_Node(tag, given, parser.CurrentLineNumber))
        parser.EndElementHandler = lambda tag: self._open.pop()
        parser.CharacterDataHandler = self._text
        parser.Parse(data, True)

    def _start(self, node: _Node) -> None:
        self._open[-1].children.append(node)
        self._open.append(node)

    def _text(self, text: str) -> None:
        self._open[-1].text += text


def _xml(root: _Node, path: str) -> Iterator[tuple[list[Declared], dict[str, str]]]:
    for node in root.walk():
        if node.tag in ("dataType", "union"):
            plain = _plain(node)
            if plain and plain.text.strip():
                yield declarations.read(plain.text, path, plain.line)
            elif node.tag == "dataType":
                yield [_structured(node, path)], {}
            else:
                yield [Declared(_name(node), "union", (), "", "", 0, "", Span(path, node.line))], {}
        elif node.tag.endswith("Vars") and node.attributes.get("constant") == "true":  # of a list, a block or a program
            yield [], {member.name.upper(): member.value for member in _variables(node, path) if member.value}
        elif node.tag == "Declaration":  # of TwinCAT
            yield declarations.read(node.text, path, node.line)


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
    name, span, comment = _name(node), Span(path, node.line), _documentation(node)
    extends, pack = "", 0
    for data in node.child("addData") or ():
        kind = data.attributes.get("name", "").rpartition("/")[2]
        if kind == "datatypeinheritance":
            extends = next((it.text.strip() for it in data.walk() if it.tag == "Extends"), "")
        elif kind == "attributes":
            modes = [it.attributes.get("Value", "") for it in data.walk() if it.attributes.get("Name") == "pack_mode"]
            pack = int(modes[0]) if modes and modes[0].isdigit() else 0
    base = node.child("baseType")
    inner = base.children[0] if base and base.children else _Node("", {}, node.line)
    if inner.tag == "struct":
        return Declared(name, "struct", tuple(_variables(inner, path)), "", extends, pack, comment, span)
    if inner.tag == "enum":
        docs = {
            (it.child("Name") or it).text: (it.child("Documentation") or it).text.strip()
            for it in node.walk()
            if it.tag == "EnumValue"
        }
        values = [
            Member(_name(it), "", it.attributes.get("value", ""), docs.get(_name(it), ""), Span(path, it.line))
            for it in inner.child("values") or ()
        ]
        over = inner.child("baseType")
        return Declared(name, "enum", tuple(values), _type(over) if over else "", extends, pack, comment, span)
    return Declared(name, "alias", (), _type(base) if base else "", extends, pack, comment, span)


def _variables(node: _Node, path: str) -> Iterator[Member]:
    for variable in (it for it in node if it.tag == "variable"):
        kind, value = variable.child("type"), variable.child("initialValue", "simpleValue")
        initial = value.attributes.get("value", "") if value else ""
        if not initial and variable.child("initialValue"):
            initial = "(…)"
        spelled = _type(kind) if kind else ""
        yield Member(_name(variable), spelled, initial, _documentation(variable), Span(path, variable.line))


def _documentation(node: _Node) -> str:
    text = node.child("documentation", "xhtml")
    return "\n".join(line.strip() for line in text.text.strip().split("\n")) if text else ""


def _type(node: _Node) -> str:
    """As Structured Text spells it."""
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
            return f"ARRAY[{', '.join(bounds)}] OF {_type(element) if element else ''}"
        case "string" | "wstring":
            length = inner.attributes.get("length")
            return f"{inner.tag.upper()}({length})" if length else inner.tag.upper()
        case "pointer" | "reference":
            element = inner.child("baseType")
            return f"{inner.tag.upper()} TO {_type(element) if element else ''}"
        case "subrangeSigned" | "subrangeUnsigned":
            element = inner.child("baseType")
            return _type(element) if element else ""
        case other:
            return other
