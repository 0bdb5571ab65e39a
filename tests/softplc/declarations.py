"""Collects the declarations in blark's trees: types, variable lists, and blocks with their methods."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import dataclass, field
from typing import Any, TypeAlias

from blark import transform as b

from tests.softplc.iec import ELEMENTARY, Array, Elementary, Named, Pointer, Text, Type
from tests.softplc.reading import CompileError, Source, Unsupported

_ALIASES = {"__UXINT": "ULINT", "__XWORD": "LWORD", "RTS_IEC_RESULT": "UDINT", "RTS_IEC_HANDLE": "LWORD"}
"""The types of a 64-bit runtime, in which a handle is as large as a pointer."""


@dataclass(frozen=True)
class Variable:
    """`section` is input, output, local, retained or constant. `initial` is a tree, a list for an array, or None."""

    name: str
    type: Type
    section: str
    initial: Any


@dataclass(frozen=True)
class Structure:
    """A structure. Its members are aligned to at most `pack` bytes."""

    name: str
    pack: int
    members: tuple[Variable, ...]


@dataclass(frozen=True)
class Enumeration:
    """`values` are names and trees. A tree is None if its value is one more than the previous value."""

    name: str
    base: Elementary
    values: tuple[tuple[str, Any], ...]
    initial: str


@dataclass(frozen=True)
class Globals:
    """A qualified variable list."""

    name: str
    constant: bool
    variables: tuple[Variable, ...]


@dataclass(frozen=True)
class Method:
    name: str
    private: bool
    result: Type | None
    variables: tuple[Variable, ...]
    body: Any

    @property
    def parameters(self) -> tuple[Variable, ...]:
        return tuple(variable for variable in self.variables if variable.section in ("input", "output"))


@dataclass(frozen=True)
class Block:
    """A FUNCTION_BLOCK or a PROGRAM. `retainable` is True if its instances may be in retained memory."""

    name: str
    variables: tuple[Variable, ...]
    body: Any
    retainable: bool
    methods: dict[str, Method] = field(default_factory=dict)


Declaration: TypeAlias = "Structure | Enumeration | Globals | Block"


def collect_declarations(sources: Iterable[Source]) -> dict[str, Declaration]:
    """Return the declarations in order, by name in capitals. Raises Unsupported, or CompileError as CODESYS would."""
    declarations: dict[str, Declaration] = {}
    block: Block | None = None
    for source in sources:
        try:
            if isinstance(source.tree, b.Method):
                if block is None:
                    raise Unsupported("a METHOD without a FUNCTION_BLOCK before it")
                method = _method(source.tree)
                if method.name in block.methods:
                    raise Unsupported(f"a second METHOD {method.name}")
                block.methods[method.name] = method
                continue
            declaration = _declaration(source)
        except Unsupported as error:
            raise Unsupported(f"{source.file}: {error}") from None
        if declaration.name in declarations:
            raise Unsupported(f"{source.file}: a second {declaration.name}")
        declarations[declaration.name] = declaration
        block = declaration if isinstance(declaration, Block) else None
    _refuse_retained(declarations)
    return declarations


def _refuse_retained(declarations: dict[str, Declaration]) -> None:
    """Raise CompileError for retained blocks that CODESYS refuses, and Unsupported for other retained variables."""
    for one in declarations.values():
        for variable in one.variables if isinstance(one, Block | Globals) else ():
            if variable.section == "retained":
                if refusing := _not_in_retain(variable.type, declarations):
                    raise CompileError(f"{one.name}.{variable.name}: {refusing} is 'no_instance_in_retain'")
                raise Unsupported("VAR RETAIN")


def _not_in_retain(type_: Type, declarations: dict[str, Declaration]) -> str:
    """Return the first block in a type that must not be in retained memory, or an empty string."""
    while isinstance(type_, Array):
        type_ = type_.of
    one = declarations.get(type_.name) if isinstance(type_, Named) else None
    if isinstance(one, Block) and not one.retainable:
        return one.name
    inner = one.members if isinstance(one, Structure) else one.variables if isinstance(one, Block) else ()
    return next(filter(None, (_not_in_retain(variable.type, declarations) for variable in inner)), "")


def _declaration(source: Source) -> Declaration:
    match source.tree:
        case b.DataTypeDeclaration(declaration=b.StructureTypeDeclaration() as tree):
            _refuse(tree.extends, "EXTENDS")
            _allow_attributes(source, "pack_mode")
            members = tuple(item for element in tree.declarations for item in _variables(element, "local"))
            return Structure(tree.name.upper(), int(source.attributes.get("pack_mode", "8")), members)
        case b.DataTypeDeclaration(declaration=b.EnumeratedTypeDeclaration() as tree):
            _allow_attributes(source, "qualified_only", "strict")
            if not {"qualified_only", "strict"} <= source.attributes.keys():
                raise Unsupported(f"the enumeration {tree.name} without 'qualified_only' and 'strict'")
            return _enumeration(tree)
        case b.GlobalVariableDeclarations() as tree:
            _allow_attributes(source, "qualified_only")
            if "qualified_only" not in source.attributes:
                raise Unsupported("VAR_GLOBAL without 'qualified_only'")
            section = _qualified(tree, "local")
            constant = section == "constant"
            member_section = "local" if constant else section
            items = tuple(item for element in tree.items for item in _variables(element, member_section))
            return Globals(source.stem.upper(), constant, items)
        case b.FunctionBlock() | b.Program() as tree:
            _allow_attributes(source, "no_instance_in_retain")
            for word in ("extends", "implements", "access"):
                _refuse(getattr(tree, word, None), word.upper())
            retainable = "no_instance_in_retain" not in source.attributes
            return Block(tree.name.upper(), tuple(_sections(tree)), tree.body, retainable)
        case b.DataTypeDeclaration(declaration=tree) | tree:
            raise Unsupported(type(tree).__name__)


def _enumeration(tree: b.EnumeratedTypeDeclaration) -> Enumeration:
    spec = tree.init.spec
    if not spec.values or spec.type_name is None:
        raise Unsupported(f"the enumeration {tree.name} without a base type")
    values = tuple((str(value.name).upper(), value.value) for value in spec.values)
    initial = values[0][0] if tree.init.value is None else str(tree.init.value.name).upper()
    base = _elementary(str(spec.type_name))
    if not isinstance(base, Elementary):
        raise Unsupported(f"the enumeration {tree.name} on {spec.type_name}")
    return Enumeration(tree.name.upper(), base, values, initial)


def _method(tree: b.Method) -> Method:
    access = (tree.access.name or "").upper() if tree.access else "PUBLIC"
    if access not in ("PUBLIC", "PRIVATE"):
        raise Unsupported(f"METHOD {access}")
    result = None if tree.return_type is None else type_of(tree.return_type.spec)
    variables = tuple(_sections(tree))
    if any(variable.section == "constant" for variable in variables):
        raise Unsupported("VAR CONSTANT in a method")
    return Method(str(tree.name).upper(), access == "PRIVATE", result, variables, tree.body)


_SECTIONS = {b.InputDeclarations: "input", b.OutputDeclarations: "output", b.VariableDeclarations: "local"}


def _sections(tree: Any) -> Iterator[Variable]:
    for block in tree.declarations or ():
        if isinstance(block, b.IncompleteLocatedVariableDeclarations) and not block.items:
            continue  # an empty VAR
        section = _SECTIONS.get(type(block))
        if section is None:
            raise Unsupported(type(block).__name__)
        for element in block.items:
            yield from _variables(element, _qualified(block, section))


def _qualified(block: Any, section: str) -> str:
    """Return the section, or the section that a word after VAR selects."""
    words = {word.name for word in type(block.attrs) if word in block.attrs} if block.attrs else set()
    if words <= {"retain", "persistent"}:
        return "retained" if words else section
    if words != {"constant"}:
        raise Unsupported(f"VAR {' '.join(sorted(words)).upper()}")
    return "constant"


def _variables(element: Any, section: str) -> Iterator[Variable]:
    names = element.spec.variables if isinstance(element, b.GlobalVariableDeclaration) else element.variables
    kind = element.init
    initial = getattr(kind, "value", None)
    if not isinstance(kind, b.TypeInitialization | b.ArrayTypeInitialization | b.StringTypeInitialization):
        raise Unsupported(f"a variable by {type(kind).__name__}")
    type_ = type_of(kind.spec)
    if isinstance(initial, b.StructureInitialization):
        raise Unsupported(type(initial).__name__)
    if isinstance(initial, b.ArrayInitialization):
        initial = list(_elements(initial))
        if not isinstance(type_, Array) or isinstance(type_.of, Array):
            raise Unsupported("initial values of an array for anything but an array of one dimension")
    for declared in names:
        variable = getattr(declared, "variable", declared)
        _refuse(getattr(declared, "location", None), "AT")
        yield Variable(str(getattr(variable, "name", variable)).upper(), type_, section, initial)


def _elements(initial: b.ArrayInitialization) -> Iterator[Any]:
    """Yield the elements of an array. After a sign, blark nests the rest of `[1, -2, 3]`."""
    for item in initial.elements:
        if getattr(item, "count", None) is not None or not isinstance(item, b.ArrayInitialElement):
            raise Unsupported("initial values that are repeated")
        if not isinstance(item.element, b.ArrayInitialization):
            yield item.element
        elif item.element.brackets:
            raise Unsupported("an array in the initial values of an array")
        else:
            yield from _elements(item.element)


def type_of(spec: Any) -> Type:
    """Return the type that a declaration names. Raises Unsupported."""
    match spec:
        case b.SimpleSpecification(type=str() as name):
            return _elementary(name)
        case b.SimpleSpecification(type=inner) | b.StringTypeInitialization(spec=inner):
            return type_of(inner)
        case b.StringTypeSpecification():
            length = 80 if spec.length is None else _number(spec.length.length)
            return Text(length, str(spec.type_name).upper() == "WSTRING")
        case b.ArraySpecification():
            type_ = type_of(spec.type)
            for subrange in reversed(spec.subranges):
                type_ = Array(_number(subrange.start), _number(subrange.stop), type_)
            return type_
        case b.IndirectSimpleSpecification(type=inner) | b.DataType(type_name=inner):
            depth = spec.indirection.pointer_depth if spec.indirection else 0
            if spec.indirection and spec.indirection.reference:
                raise Unsupported("REFERENCE TO")
            type_ = _elementary(inner) if isinstance(inner, str) else type_of(inner)
            for _ in range(depth):
                type_ = Pointer(type_)
            return type_
        case _:
            raise Unsupported(f"the type {type(spec).__name__}")


def _elementary(name: str) -> Type:
    name = _ALIASES.get(name.upper(), name.upper())
    return Elementary(name) if name in ELEMENTARY else Named(name)


def _number(tree: Any) -> int:
    if isinstance(tree, b.ParenthesizedExpression):
        return _number(tree.expr)
    if isinstance(tree, b.UnaryOperation) and str(tree.op) == "-":
        return -_number(tree.expr)
    if type(tree) is not b.Integer:
        raise Unsupported("a length or a bound that is no decimal number")
    return int(str(tree.value).replace("_", ""))


def _refuse(value: Any, word: str) -> None:
    if value:
        raise Unsupported(word)


def _allow_attributes(source: Source, *names: str) -> None:
    for name in source.attributes.keys() - set(names):
        raise Unsupported(f"the attribute '{name}'")
