"""Turns the text of an .idl file into Messages that know the place of every word.

rosidl_parser takes the text apart. Only its syntax tree is used: what it makes of that has lost the places, and takes
`sequence<wstring<5>>` for a bounded sequence.
"""

from __future__ import annotations

import re
from bisect import bisect
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from textwrap import dedent
from typing import Any, NamedTuple, TypeVar

from shmgen.core.diagnostics import Report, Span
from shmgen.core.model import Array, Constant, Field, FieldType, Message, Ref, Scalar, Sequence, String, TypeName
from shmgen.definitions import comments
from shmgen.definitions.annotations import Annotation, Text, spelled, take_out, text_of
from shmgen.definitions.fieldtypes import CLOCKS, read_bound
from shmgen.definitions.literals import read_constant, read_default
from shmgen.definitions.parser import SECTIONS, Source, lines_of
from shmgen.definitions.rosidl import syntax_tree, words
from shmgen.definitions.tokens import Token, Wrong, shown


def parse(source: Source, report: Report) -> tuple[Message, ...]:
    """One message for a file in msg/, two in srv/, three in action/; what is wrong goes to the report.

    SHM003, SHM004, SHM005, SHM006, SHM008, SHM102, SHM201, SHM302.
    """
    lines = lines_of(source, report)
    try:
        file = _taken_apart(source, Text.of(lines)) if lines else None
        return tuple(_message(file, struct, report) for struct in file.structs) if file else ()
    except Wrong as wrong:
        report.error(wrong.code, wrong.message, wrong.span, hint=wrong.hint)
        return ()


class _File(NamedTuple):
    """Its declarations, as nodes of the tree: typedefs and structures by name, constants by their module.

    `code` is the text without annotations; those are `noted` by the place of the name that they are about.
    """

    source: Source
    text: Text
    code: str
    noted: Mapping[int, list[Annotation]]
    typedefs: Mapping[str, tuple[Any, Any]]
    constants: Mapping[str, list[Any]]
    structs: list[Any]

    def token(self, name: Any) -> Token:
        return self.text.token(name.start_pos, str(name))


_SCALARS = {
    "boolean_type": Scalar.BOOL,
    "octet_type": Scalar.UINT8,
    "char_type": Scalar.UINT8,  # as in rosidl_generator_cpp, and as `char` is in a .msg
    "wide_char_type": Scalar.UINT16,
    "signed_tiny_int": Scalar.INT8,
    "unsigned_tiny_int": Scalar.UINT8,
    "signed_short_int": Scalar.INT16,
    "unsigned_short_int": Scalar.UINT16,
    "signed_long_int": Scalar.INT32,
    "unsigned_long_int": Scalar.UINT32,
    "signed_longlong_int": Scalar.INT64,
    "unsigned_longlong_int": Scalar.UINT64,
    "floating_pt_type_float": Scalar.FLOAT32,
    "floating_pt_type_double": Scalar.FLOAT64,
}
_WORDS = {"octet_type": "byte", "char_type": "char", "wide_char_type": "wchar"}
_AROUND = {
    "const_type",
    "type_spec",
    "simple_type_spec",
    "base_type_spec",
    "template_type_spec",
    "integer_type",
    "signed_int",
    "unsigned_int",
    "floating_pt_type",
}
"""Rules of the grammar that hold nothing but another."""
_FILLER = "structure_needs_at_least_one_member"
"""How rosidl_adapter writes a message without fields."""
_DEEPEST_TYPEDEF = 20
_ASSIGNED = re.compile(r'\s*=\s*((?:L?"(?:\\.|[^"\\\n])*"\s*)+|[^;"]*)')


def _taken_apart(source: Source, text: Text) -> _File:
    code, annotations = take_out(text)
    typedefs: dict[str, tuple[Any, Any]] = {}
    constants: dict[str, list[Any]] = {}
    structs: dict[str, tuple[tuple[str, ...], Any]] = {}
    places = [len(code)]
    for modules, node in _declarations(syntax_tree(code, text)):
        if node.data == "typedef_dcl":
            type_, declarators = node.children[0].children
            typedefs |= {str(_name(one.children[0])): (type_, one.children[0]) for one in declarators.children}
        elif node.data == "const_dcl":
            constants.setdefault(modules[-1] if modules else "", []).append(node)
        elif node.data == "struct_def":
            structs[str(_name(node))] = modules, node
        places += _places(node)
    places.sort()
    noted: dict[int, list[Annotation]] = {}
    for annotation in annotations:
        noted.setdefault(places[bisect(places, annotation.start)], []).append(annotation)
    file = _File(source, text, code, noted, typedefs, constants, [])
    file.structs.extend(_structs_of(file, structs))
    return file


def _declarations(tree: Any) -> Iterator[tuple[tuple[str, ...], Any]]:
    """Constants, typedefs, structures and enumerations in order, with the modules around them."""
    waiting: list[tuple[tuple[str, ...], Any]] = [((), tree)]
    while waiting:
        modules, node = waiting.pop()
        if node.data in ("const_dcl", "typedef_dcl", "struct_def", "enum_dcl"):
            yield modules, node
        elif node.data in ("specification", "definition", "module_dcl", "type_dcl", "constr_type_dcl", "struct_dcl"):
            around = (*modules, str(_name(node))) if node.data == "module_dcl" else modules
            waiting += [(around, inner) for inner in reversed(list(_nodes(node)))]


def _structs_of(file: _File, found: Mapping[str, tuple[tuple[str, ...], Any]]) -> Iterator[Any]:
    """Those that the file must hold, in order. Raises Wrong: SHM003 for others."""
    package, kind, name = file.source.name
    wanted = [name + ending for ending in SECTIONS[kind]]
    for struct, (modules, node) in found.items():
        if struct not in wanted or modules != (package, kind):
            is_called = "::".join((*modules, struct))
            hint = f"a file {name}.idl in {kind}/ holds {' and '.join(f'{package}::{kind}::{one}' for one in wanted)}"
            raise file.token(_name(node)).wrong("SHM003", f"a structure is called {shown(is_called)}", hint)
    for struct in wanted:
        if struct not in found:
            raise file.text.token(0, "").wrong("SHM003", f"no structure is called {shown(struct)}")
        yield found[struct][1]


def _message(file: _File, struct: Any, report: Report) -> Message:
    name = file.source.name._replace(name=str(_name(struct)))
    fields: dict[str, Field] = {}
    constants: dict[str, Constant] = {}
    for node in file.constants.get(f"{name.name}_Constants", ()):
        with _reported(name, _name(node), report):
            _add(constants, _constant(file, node), file.token(_name(node)))
    for member in (node for node in _nodes(struct) if node.data == "member"):
        first, *_ = declarators = _declarators(member)
        for declarator in declarators:
            with _reported(name, _name(declarator), report):
                _add(fields, _field(file, member, _name(first), declarator), file.token(_name(declarator)))
    if list(fields) == [_FILLER]:
        fields = {}
    span = Span(file.source.path) if name == file.source.name else file.token(_name(struct)).span
    doc, text = _doc(file, _name(struct)), file.text.whole
    return Message(name, tuple(fields.values()), tuple(constants.values()), span, file.source.origin, text, doc)


@contextmanager
def _reported(message: TypeName, name: Any, report: Report) -> Iterator[None]:
    """What is wrong with one declaration is told, and the others are read."""
    try:
        yield
    except Wrong as wrong:
        report.error(wrong.code, wrong.message, wrong.span, field=f"{message.short}.{name}", hint=wrong.hint)


D = TypeVar("D", Field, Constant)


def _add(known: dict[str, D], declared: D, name: Token) -> None:
    if declared.name in known:
        again = f"{shown(declared.name)} is already declared in line {known[declared.name].span.line}"
        raise name.wrong("SHM201", again, "give one of them another name")
    known[declared.name] = declared


def _constant(file: _File, node: Any) -> Constant:
    name = file.token(_name(node))
    type_ = _type(file, next(_nodes(node)), name)
    if not isinstance(type_, Scalar | String):
        raise name.wrong("SHM006", "a constant is a single number, bool or string")
    assigned = _ASSIGNED.match(file.code, _name(node).start_pos + len(name.text))
    literal = spelled(assigned[1].strip()) if assigned else ""
    value = _read(name, literal, lambda written: read_constant(written, type_, "ros2"))
    type_ = String(wide=type_.wide) if isinstance(type_, String) else type_
    return Constant(name.text, type_, value, name.span, _doc(file, _name(node)))


def _field(file: _File, member: Any, first: Any, declarator: Any) -> Field:
    """`first` is the name behind the type: the others follow behind commas."""
    name = file.token(_name(declarator))
    notes = {note.name: note.values.get("value", "") for note in file.noted.get(first.start_pos, ())}
    if "optional" in notes:
        raise name.wrong("SHM003", "an optional field has no fixed place", "take `@optional` away")
    type_ = _lengthened(_type(file, next(_nodes(member)), name), declarator, name)
    start = max(file.code.rfind(sign, 0, first.start_pos) for sign in ";{") + 1
    written = file.code[start : first.start_pos]
    start += len(written) - len(written.lstrip())
    place = file.text.token(start, written.strip().partition("\n")[0])
    default = None
    if "default" in notes:
        literal = spelled(notes["default"])
        if isinstance(type_, Array | Sequence):  # rosidl_adapter writes those as Python spells a tuple, in quotes
            listed = text_of(notes["default"]).strip()
            literal = f"[{listed[1:-1].rstrip().removesuffix(',')}]" if listed[:1] == "(" else listed
        default = _read(name, literal, lambda written: read_default(written, type_))
    doc, unit = comments.unit_of(_doc(file, first))
    unit = text_of(notes["unit"]) if "unit" in notes else unit
    word = _word(file, next(_nodes(member)))
    return Field(name.text, type_, " ".join(written.split()), place.span, doc, unit, default, word)


V = TypeVar("V")


def _read(name: Token, literal: str, read: Callable[[Token], tuple[V, Token]]) -> V:
    """Complaints are about the name: the literal is not spelled as in the file."""
    try:
        value, rest = read(name._replace(text=literal))
    except Wrong as wrong:
        raise Wrong(wrong.code, wrong.message, name.span, wrong.hint) from None
    if rest.text:
        raise name.wrong("SHM006", f"{shown(rest.text)} is left over behind the value")
    return value


def _type(file: _File, node: Any, name: Token, depth: int = 0) -> FieldType:
    """Of the declaration called `name`. Raises Wrong: SHM003, SHM004, SHM102 or SHM302."""
    while node.data in _AROUND:
        node = node.children[0]
    if node.data in _SCALARS:
        return _SCALARS[node.data]
    if node.data in ("string_type", "wide_string_type"):
        capacity = _number(node.children[0], name, "SHM102") if node.children else None
        return String(capacity, node.data == "wide_string_type")
    if node.data == "sequence_type":
        inner = node.children[0].children[0].children[0]
        element = None if inner.data == "sequence_type" else _type(file, node.children[0], name, depth)
        if element is None or isinstance(element, Array | Sequence):
            raise name.wrong("SHM003", "an array has one dimension", "put the inner one into a message of its own")
        return Sequence(element, _number(node.children[1], name, "SHM102") if len(node.children) > 1 else None)
    if node.data != "scoped_name":
        raise name.wrong("SHM003", "no message has this type", "a number has 64 bits at most")
    parts = [str(word) for word in words(node)]
    if len(parts) == 1 and parts[0] in file.typedefs and depth < _DEEPEST_TYPEDEF:
        inner, declarator = file.typedefs[parts[0]]
        return _lengthened(_type(file, inner, name, depth + 1), declarator, name)
    if len(parts) != 3:
        hint = "a message is `package::msg::Name`; an enumeration has no counterpart in a .msg"
        raise name.wrong("SHM004", f"no type is called {shown('::'.join(parts))} here", hint)
    if parts[0] == "builtin_interfaces" and parts[2] in CLOCKS:
        return CLOCKS[parts[2]]
    return Ref(TypeName(*parts))


def _word(file: _File, node: Any, depth: int = 0) -> str:
    """Of the element, however it is wrapped, where a number does not say all of it."""
    while node.data in _AROUND or node.data == "sequence_type":
        node = node.children[0]
    if node.data == "scoped_name" and (found := file.typedefs.get(str(words(node)[-1]))) and depth < _DEEPEST_TYPEDEF:
        return _word(file, found[0], depth + 1)
    return _WORDS.get(node.data, "")


def _lengthened(element: FieldType, declarator: Any, name: Token) -> FieldType:
    """The type, if the declarator is `x[4]` an array of it."""
    lengths = list(_nodes(declarator))
    if not lengths:
        return element
    if len(lengths) > 1 or isinstance(element, Array | Sequence):
        raise name.wrong("SHM003", "an array has one dimension", "put the inner one into a message of its own")
    return Array(element, _number(lengths[0].children[0], name, "SHM302"))


def _number(node: Any, name: Token, if_zero: str) -> int:
    digits = "".join(words(node))
    if any(node.find_pred(lambda inner: inner.data in ("octal_literal", "hexadecimal_literal", "unary_operator"))):
        raise name.wrong("SHM102", "a bound is a whole number, written in decimal")
    try:
        return read_bound(name._replace(text=digits), if_zero)
    except Wrong as wrong:
        raise Wrong(wrong.code, wrong.message, name.span, wrong.hint) from None


def _doc(file: _File, name: Any) -> str:
    notes = (note.values for note in file.noted.get(name.start_pos, ()) if note.name == "verbatim")
    said = [text_of(values.get("text", "")) for values in notes if text_of(values.get("language", "")) == "comment"]
    return dedent("\n".join(line.rstrip() for text in said for line in text.splitlines())).strip("\n")


def _nodes(node: Any) -> Iterator[Any]:
    return (child for child in node.children if not isinstance(child, str))


def _name(node: Any) -> Any:
    """The word, with its place, that a node declares."""
    return next(child for child in node.children if isinstance(child, str))


def _declarators(node: Any) -> list[Any]:
    """`x`, `y[3]`: of fields, types and the words of an enumeration, in order."""
    found = node.find_pred(lambda inner: inner.data in ("simple_declarator", "array_declarator", "enumerator"))
    return sorted(found, key=lambda declarator: _name(declarator).start_pos)


def _places(node: Any) -> list[int]:
    """Of all the names in a declaration."""
    own = [child for child in node.children if isinstance(child, str)]
    return [name.start_pos for name in (*own, *map(_name, _declarators(node)))]
