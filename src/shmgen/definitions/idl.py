"""Parse the text of an .idl file into Messages with the position of every word.

Only the syntax tree of rosidl_parser is used. The later results of rosidl_parser have no positions, and wrongly
represent `sequence<wstring<5>>`, an unbounded sequence, as a bounded one.
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
from shmgen.core.type_hash import FILLER
from shmgen.definitions import comments, syntax_hints
from shmgen.definitions.annotations import Annotation, Text, extract_annotations, text_of, to_msg_literal
from shmgen.definitions.catalogue import SECTIONS, Definition
from shmgen.definitions.fieldtypes import CLOCKS, read_bound
from shmgen.definitions.literals import read_constant, read_default
from shmgen.definitions.parser import lines_of
from shmgen.definitions.rosidl import syntax_tree, words
from shmgen.definitions.tokens import DefinitionError, Token, quote


def parse(definition: Definition, text: str, report: Report) -> tuple[Message, ...]:
    """Return the messages of an .idl file: one if the file is in msg/, two in srv/, three in action/.

    Return an empty tuple if the file is not usable. Errors go to the report: SHM001, SHM003, SHM004, SHM005, SHM006,
    SHM008, SHM102, SHM201, SHM302.
    """
    lines = lines_of(text, definition.path, report)
    try:
        file = _split(definition, Text(lines, "\n".join(line.text for line in lines))) if lines else None
        return tuple(_message(file, struct, report) for struct in _expected_structs(file)) if file else ()
    except DefinitionError as error:
        report.error(error.code, error.message, error.span, hint=error.hint)
        return ()


class _File(NamedTuple):
    """An .idl file with its declarations, as nodes of the syntax tree.

    `typedefs` maps a name to its type and declarator. `constants` maps the name of a module to its constants. `structs`
    maps a name to the names of the modules around the structure, and the structure. `code` is the text without
    annotations. The annotations of a declaration are in `noted`, under the position of the declared name.
    """

    definition: Definition
    text: Text
    code: str
    noted: Mapping[int, list[Annotation]]
    typedefs: Mapping[str, tuple[Any, Any]]
    constants: Mapping[str, list[Any]]
    structs: Mapping[str, tuple[tuple[str, ...], Any]]
    enums: set[str]

    @property
    def expected(self) -> list[str]:
        """The names of the structures that the file must contain."""
        _, kind, name = self.definition.name
        return [name + ending for ending in SECTIONS[kind]]

    def token(self, name: Any) -> Token:
        return self.text.token(name.start_pos, str(name))


_SCALARS = {
    "boolean_type": Scalar.BOOL,
    "octet_type": Scalar.UINT8,
    "char_type": Scalar.UINT8,  # like rosidl_generator_cpp, and like `char` in a .msg
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
_WRAPPER_RULES = {
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
"""Grammar rules that only wrap another rule."""
_DEEPEST_TYPEDEF = 20
_ASSIGNED = re.compile(r'\s*=\s*((?:L?"(?:\\.|[^"\\\n])*"\s*)+|[^;"]*)')


def _split(definition: Definition, text: Text) -> _File:
    code, annotations = extract_annotations(text)
    typedefs: dict[str, tuple[Any, Any]] = {}
    constants: dict[str, list[Any]] = {}
    structs: dict[str, tuple[tuple[str, ...], Any]] = {}
    enums: set[str] = set()
    places = [len(code)]
    for modules, node in _declarations(syntax_tree(code, text)):
        if node.data == "typedef_dcl":
            type_, declarators = node.children[0].children
            typedefs |= {str(_name(one.children[0])): (type_, one.children[0]) for one in declarators.children}
        elif node.data == "const_dcl":
            constants.setdefault(modules[-1] if modules else "", []).append(node)
        elif node.data == "struct_def":
            structs[str(_name(node))] = modules, node
        elif node.data == "enum_dcl":
            enums.add(str(_name(node)))
        places += _places(node)
    places.sort()
    noted: dict[int, list[Annotation]] = {}
    for annotation in annotations:
        noted.setdefault(places[bisect(places, annotation.start)], []).append(annotation)
    return _File(definition, text, code, noted, typedefs, constants, structs, enums)


def _declarations(tree: Any) -> Iterator[tuple[tuple[str, ...], Any]]:
    """Yield each constant, typedef, structure and enumeration, preceded by the names of the modules around it."""
    waiting: list[tuple[tuple[str, ...], Any]] = [((), tree)]
    while waiting:
        modules, node = waiting.pop()
        if node.data in ("const_dcl", "typedef_dcl", "struct_def", "enum_dcl"):
            yield modules, node
        elif node.data in ("specification", "definition", "module_dcl", "type_dcl", "constr_type_dcl", "struct_dcl"):
            around = (*modules, str(_name(node))) if node.data == "module_dcl" else modules
            waiting += [(around, inner) for inner in reversed(list(_nodes(node)))]


def _expected_structs(file: _File) -> list[Any]:
    """Return the structures that the file must contain, in order.

    Raises DefinitionError (SHM003) if a structure is missing or the file contains another structure.
    """
    (package, kind, name), expected = file.definition.name, file.expected
    for struct, (modules, node) in file.structs.items():
        if struct not in expected or modules != (package, kind):
            is_called = "::".join((*modules, struct))
            hint = f"declare only {' and '.join(f'{package}::{kind}::{one}' for one in expected)} in {kind}/{name}.idl"
            raise file.token(_name(node)).error("SHM003", f"unexpected structure {quote(is_called)}", hint)
    for struct in expected:
        if struct not in file.structs:
            raise file.text.token(0, "").error("SHM003", f"the structure {quote(struct)} is missing")
    return [file.structs[struct][1] for struct in expected]


def _message(file: _File, struct: Any, report: Report) -> Message:
    name = file.definition.name._replace(name=str(_name(struct)))
    fields: dict[str, Field] = {}
    constants: dict[str, Constant] = {}
    for node in file.constants.get(f"{name.name}_Constants", ()):
        with _reporting(name, _name(node), report):
            _add(constants, _constant(file, node), file.token(_name(node)))
    for member in (node for node in _nodes(struct) if node.data == "member"):
        first, *_ = declarators = _declarators(member)
        for declarator in declarators:
            with _reporting(name, _name(declarator), report):
                _add(fields, _field(file, member, _name(first), declarator), file.token(_name(declarator)))
    if list(fields) == [FILLER]:
        fields = {}
    span = Span(file.definition.path) if name == file.definition.name else file.token(_name(struct)).span
    doc, text = _doc(file, _name(struct)), file.text.whole
    return Message(name, tuple(fields.values()), tuple(constants.values()), span, file.definition.origin, text, doc)


@contextmanager
def _reporting(message: TypeName, name: Any, report: Report) -> Iterator[None]:
    """Report a DefinitionError of the `with` block, so that the parser continues with the next declaration."""
    try:
        yield
    except DefinitionError as error:
        report.error(error.code, error.message, error.span, field=f"{message.short}.{name}", hint=error.hint)


D = TypeVar("D", Field, Constant)


def _add(known: dict[str, D], declared: D, name: Token) -> None:
    if declared.name in known:
        problem = f"{quote(declared.name)} is already declared in line {known[declared.name].span.line}"
        raise name.error("SHM201", problem, "rename one of them")
    known[declared.name] = declared


def _constant(file: _File, node: Any) -> Constant:
    name = file.token(_name(node))
    type_ = _type(file, next(_nodes(node)), name)
    if not isinstance(type_, Scalar | String):
        raise name.error("SHM006", "a constant must be a single number, bool or string")
    assigned = _ASSIGNED.match(file.code, _name(node).start_pos + len(name.text))
    literal = to_msg_literal(assigned[1].strip()) if assigned else ""
    value = _read(name, literal, lambda written: read_constant(written, type_, "ros2"))
    unbounded = String(wide=type_.wide) if isinstance(type_, String) else type_
    return Constant(name.text, unbounded, value, name.span, _doc(file, _name(node)))


def _field(file: _File, member: Any, first: Any, declarator: Any) -> Field:
    """Return the field that `declarator` declares. A member such as `double x, y;` has a declarator for each field.

    `first` is the first of the member's names. The type ends before this name, and the member's annotations are stored
    under the position of this name.
    """
    name = file.token(_name(declarator))
    notes = {note.name: note.values.get("value", "") for note in file.noted.get(first.start_pos, ())}
    if "optional" in notes:
        raise name.error("SHM003", "an optional field has no fixed offset", "remove `@optional`")
    type_ = _with_length(_type(file, next(_nodes(member)), name), declarator, name)
    start = max(file.code.rfind(sign, 0, first.start_pos) for sign in ";{") + 1
    written = file.code[start : first.start_pos]
    start += len(written) - len(written.lstrip())
    place = file.text.token(start, written.strip().partition("\n")[0])
    default = None
    if "default" in notes:
        literal = to_msg_literal(notes["default"])
        if isinstance(type_, Array | Sequence):  # rosidl_adapter writes a Python tuple in quotes
            listed = text_of(notes["default"]).strip()
            literal = f"[{listed[1:-1].rstrip().removesuffix(',')}]" if listed[:1] == "(" else listed
        default = _read(name, literal, lambda written: read_default(written, type_))
    doc, unit = comments.split_unit(_doc(file, first))
    unit = text_of(notes["unit"]) if "unit" in notes else unit
    word = _word(file, next(_nodes(member)))
    return Field(name.text, type_, " ".join(written.split()), place.span, doc, unit, default, word)


V = TypeVar("V")


def _read(name: Token, literal: str, read: Callable[[Token], tuple[V, Token]]) -> V:
    """Parse a literal of a default or a constant with the function `read`, and return its value.

    Errors point at the declared `name`, because `literal` is not spelled as in the file.
    """
    try:
        value, rest = read(name._replace(text=literal))
    except DefinitionError as error:
        raise DefinitionError(error.code, error.message, name.span, error.hint) from None
    if rest.text:
        raise name.error("SHM006", f"{quote(rest.text)} is unexpected after the value")
    return value


def _type(file: _File, node: Any, name: Token, depth: int = 0) -> FieldType:
    """Return the type of the declaration `name`.

    Raises DefinitionError (SHM003, SHM004, SHM102 or SHM302) if the type is invalid.
    """
    while node.data in _WRAPPER_RULES:
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
            raise name.error("SHM003", "an array has one dimension", "declare the inner array in its own message")
        return Sequence(element, _number(node.children[1], name, "SHM102") if len(node.children) > 1 else None)
    if node.data != "scoped_name":
        raise name.error("SHM003", "ROS has no such type", "use a number of at most 64 bits, a string or a message")
    parts = [str(word) for word in words(node)]
    if len(parts) == 1 and parts[0] in file.typedefs and depth < _DEEPEST_TYPEDEF:
        inner, declarator = file.typedefs[parts[0]]
        return _with_length(_type(file, inner, name, depth + 1), declarator, name)
    if parts in ([struct] for struct in file.expected):  # the schema rejects this type as recursive
        return Ref(file.definition.name._replace(name=parts[0]))
    if len(parts) != 3:
        raise name.error("SHM004", f"unknown type {quote('::'.join(parts))}", _hint(file, parts))
    if parts[0] == "builtin_interfaces" and parts[2] in CLOCKS:
        return CLOCKS[parts[2]]
    return Ref(TypeName(*parts))


def _hint(file: _File, parts: list[str]) -> str:
    if parts[-1] in file.enums:
        return "use `uint32`, and constants in `module Name_Constants`: ROS has no enumerations"
    similar = syntax_hints.builtin_of_idl(parts[0]) if len(parts) == 1 else ""
    return f"did you mean `{similar}`?" if similar else "write the type of a message as `package::msg::Name`"


def _word(file: _File, node: Any, depth: int = 0) -> str:
    """Return `byte`, `char` or `wchar` if a field's innermost element has this IDL type, else `""`.

    The parsed type of the field does not show the IDL type: `octet` and `uint8` both become Scalar.UINT8.
    """
    while node.data in _WRAPPER_RULES or node.data == "sequence_type":
        node = node.children[0]
    if node.data == "scoped_name" and (typedef := file.typedefs.get(str(words(node)[-1]))) and depth < _DEEPEST_TYPEDEF:
        return _word(file, typedef[0], depth + 1)
    return _WORDS.get(node.data, "")


def _with_length(element: FieldType, declarator: Any, name: Token) -> FieldType:
    """Return an array of `element` if the declarator has a length such as `x[4]`, else `element`."""
    lengths = list(_nodes(declarator))
    if not lengths:
        return element
    if len(lengths) > 1 or isinstance(element, Array | Sequence):
        raise name.error("SHM003", "an array has one dimension", "declare the inner array in its own message")
    return Array(element, _number(lengths[0].children[0], name, "SHM302"))


def _number(node: Any, name: Token, if_zero: str) -> int:
    digits = "".join(words(node))
    if any(node.find_pred(lambda inner: inner.data in ("octal_literal", "hexadecimal_literal", "unary_operator"))):
        raise name.error("SHM102", "a bound must be a decimal whole number")
    try:
        return read_bound(name._replace(text=digits), if_zero)
    except DefinitionError as error:
        raise DefinitionError(error.code, error.message, name.span, error.hint) from None


def _doc(file: _File, name: Any) -> str:
    notes = (note.values for note in file.noted.get(name.start_pos, ()) if note.name == "verbatim")
    texts = [text_of(values.get("text", "")) for values in notes if text_of(values.get("language", "")) == "comment"]
    return dedent("\n".join(line.rstrip() for text in texts for line in text.splitlines())).strip("\n")


def _nodes(node: Any) -> Iterator[Any]:
    return (child for child in node.children if not isinstance(child, str))


def _name(node: Any) -> Any:
    """Return the name that a node declares, with its position."""
    return next(child for child in node.children if isinstance(child, str))


def _declarators(node: Any) -> list[Any]:
    """Return the declarators such as `x` and `y[3]` of fields, typedefs and enumerations, in order."""
    declarators = node.find_pred(lambda inner: inner.data in ("simple_declarator", "array_declarator", "enumerator"))
    return sorted(declarators, key=lambda declarator: _name(declarator).start_pos)


def _places(node: Any) -> list[int]:
    """Return the positions in the text of all names in a declaration."""
    own = [child for child in node.children if isinstance(child, str)]
    return [name.start_pos for name in (*own, *map(_name, _declarators(node)))]
