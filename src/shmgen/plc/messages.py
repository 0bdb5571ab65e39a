"""Write the data types of a PLC project as .msg files of one ROS package.

A structure becomes a message. An enumeration becomes a message with its names as constants and the field `value`.
If a name differs in ROS, a comment such as `(PLC: rSpeed)` keeps the PLC's name for generated Structured Text.
"""

from __future__ import annotations

import itertools
import re
from typing import NamedTuple

from shmgen.core.diagnostics import Diagnostic, Report, Span
from shmgen.core.plural import counted
from shmgen.plc import text as around
from shmgen.plc import types
from shmgen.plc.compiled import EMPTY, NATURAL, Converted, Sum, differences
from shmgen.plc.declarations import MOST, Declaration, Member
from shmgen.plc.numbers import NotConvertible, Numbers
from shmgen.plc.sources import Project
from shmgen.plc.text import commented, field_lines, head, of_messages, snake, unique


class Row(NamedTuple):
    """A data type of the project and the result of its import: the name and the size in bytes of its message.

    If the type cannot be a message, `why` is the reason, otherwise `""`. `sure` is False if the size depends on an
    empty structure, whose size in a PLC is not verified. `verified_by` is the .tmc file that has the type with the same
    bytes, or `""`.
    """

    declared: Declaration
    message: str
    size: int
    sure: bool = True
    why: str = ""
    verified_by: str = ""


class Imported(NamedTuple):
    """The result of an import: the files of the ROS package, and the data types of the project.

    `texts` maps the path of each file to its text. `notes` are diagnostics that do not stop the import.
    """

    texts: dict[str, str]
    rows: list[Row]
    notes: list[Diagnostic]


def messages(project: Project, package: str, report: Report) -> Imported:
    """Convert the data types of a project to messages. Types that cannot be messages go to the report.

    * SHM601: ROS has no equivalent type.
    * SHM602: the project does not declare a name, or an expression cannot be computed.
    * SHM603: the bytes differ from a .tmc file.
    * SHM201: a name is declared twice with different content.
    * SHM301: a type contains or extends itself, or a constant refers to itself.
    * SHM303: a type is too large.
    * SHM304: types are nested too deeply.
    """
    work = _Work(project)
    rows, texts = [], {}
    for declared in project.types:
        result = work.convert(declared)
        if isinstance(result, NotConvertible):
            rows.append(Row(declared, "", 0, why=result.message))
        else:
            proof = work.verified.get(declared.name, "")
            rows.append(Row(declared, result.name, result.size, result.sure, verified_by=proof))
            texts[f"msg/{result.name}.msg"] = result.text
    report.diagnostics += work.diagnostics()
    if texts:
        times = any("builtin_interfaces/" in text for text in texts.values())
        texts |= {
            "package.xml": around.manifest(package, times),
            "CMakeLists.txt": around.cmake(package, sorted(texts), times),
        }
    return Imported(texts, rows, [_mistyped_pack(it) for it in project.types if it.mistyped_pack])


def _mistyped_pack(declared: Declaration) -> Diagnostic:
    message = f"{declared.name} is not packed: {{attribute {declared.mistyped_pack}}} is not a pack_mode"
    hint = "write {attribute 'pack_mode' := '1'}; the numbers are 0, 1, 2, 4 and 8"
    return Diagnostic("SHM003", message, declared.span, hint=hint, level="note")


class _Place(NamedTuple):
    span: Span
    where: str


_DEEPEST = 50
"""The limit of nested messages, and of bases of bases."""
_PLACES = 5
"""The largest number of further positions that are shown for one error."""


_MOST_HINTS = 20
"""The largest number of errors whose hint suggests a similar name."""


class _Work:
    """Converts the data types of a project to messages: each type once, after the types that it contains."""

    def __init__(self, project: Project) -> None:
        self.numbers = Numbers(project.constants, project.types)
        self.declared = {it.name.upper(): it for it in project.types}
        self.conflicts = project.conflicts
        self.compiled = project.compiled
        self.verified: dict[str, str] = {}
        """Type -> .tmc file with the same bytes."""
        self.names = of_messages([it.name for it in project.types])
        self.done: dict[str, Converted | NotConvertible] = {}
        self.path: list[str] = []
        self.members = 0
        self.faults: dict[tuple[str, str], tuple[NotConvertible, list[_Place]]] = {}

    def diagnostics(self) -> list[Diagnostic]:
        """Return one diagnostic for each error, with the declarations or members in which the error occurs."""
        diagnostics = []
        for error, (first, *others) in self.faults.values():
            details = list(error.details)
            details += (f"also {it.where} ({it.span.path}:{it.span.line})" for it in others[:_PLACES])
            if left := len(others[_PLACES:]):
                details.append(f"and {counted(left, 'place')} more")
            field = first.where if "." in first.where else ""
            diagnostics.append(Diagnostic(error.code, error.message, first.span, field, error.hint, tuple(details)))
        return diagnostics

    def convert(self, declared: Declaration) -> Converted | NotConvertible:
        """Return the message for a data type, or the reason why there is none. Convert each data type once."""
        key = declared.name.upper()
        if key not in self.done:
            self.path.append(key)
            try:
                self.done[key] = self._check_bytes(declared, self._convert(declared))
            except NotConvertible as error:
                self.done[key] = self._remember(error, declared, None)
            self.path.pop()
        return self.done[key]

    def _convert(self, declared: Declaration) -> Converted | NotConvertible:
        if other := self.conflicts.get(declared.name.upper()):
            places = f"{other.span.path}:{other.span.line}"
            hint = "import only one of the two projects; if you need both types, rename one of them"
            raise NotConvertible(f"{declared.name} is declared differently in {places}", hint, "SHM201")
        match declared.kind:
            case "struct":
                return self._structure(declared)
            case "enum":
                return self._enumeration(declared)
            case "alias":
                return self._alias(declared)
        hint = "copy the member that you need into a structure"
        raise NotConvertible(f"{declared.name} is a union, which ROS does not have", hint)

    def _check_bytes(self, declared: Declaration, result: Converted | NotConvertible) -> Converted | NotConvertible:
        """Return `result`, the message for a type, if it has the same bytes as the type in the project's .tmc files.

        Raises NotConvertible (SHM603) if the bytes differ.
        """
        if isinstance(result, Converted):
            for compiled in self.compiled.get(declared.name.upper(), ()):
                if lines := tuple(itertools.islice(differences(declared, result, compiled), _PLACES)):
                    hint = f"build the project in TwinCAT again, so that {compiled.file} has the types of these files"
                    hint += "\nif it still differs, please report it; --skip leaves the type out"
                    raise NotConvertible(f"{declared.name} differs from {compiled.file}", hint, "SHM603", lines)
                if compiled.has_all(declared):
                    self.verified.setdefault(declared.name, compiled.file)
        return result

    def _structure(self, declared: Declaration) -> Converted | NotConvertible:
        """Convert a structure if the PLC's compiler and the message definition give its members the same places.

        `compiled` is the layout by the compiler, `message` by the message definition, and `natural` without pack_mode.
        """
        *bases, _ = line = self._line(declared)
        base_layouts = [self._base(it) for it in bases]
        base = next((it for it in reversed(base_layouts) if it.places), EMPTY)
        pack = declared.pack or NATURAL
        compiled, message, natural = Sum(pack, base), Sum(pack), Sum(NATURAL)
        members = [(member, index) for index, it in enumerate(line) for member in it.members]
        names = unique([snake(member.name) for member, _ in members])
        lines: list[str] = []
        failed: NotConvertible | None = None
        sure = bool(members) and all(it.places for it in base_layouts)
        for (member, index), name in zip(members, names, strict=True):
            begins = base_layouts[index - 1].alignment if index and member is line[index].members[0] else 1
            try:
                field = types.field(member.type, self.numbers.value, self._names_of)
                layout = self._layout(field)
                if index == len(bases):
                    self._check_pack(declared, field, layout)
                    compiled.add(layout, field.many)
                natural.add(layout, field.many, begins)
                moved = message.add(layout, field.many, begins)
                if message.at > types.LARGEST:
                    raise NotConvertible(f"more than {types.LARGEST:,} bytes", "declare a smaller type", "SHM303")
            except NotConvertible as error:
                failed = self._remember(error, declared, member)
                continue
            sure = sure and layout.sure
            lines += field_lines(name, member, field, f", align {begins}" if moved else "")
        if failed:
            return failed
        if compiled != message:
            hint = "give both the same pack_mode, or copy the needed members into a structure without EXTENDS"
            raise NotConvertible(f"{declared.name} and its base have different pack_modes", hint)
        note = f", pack_mode {pack}" if message != natural else ""
        text = "\n".join([*head(declared, f"PLC: {declared.name}{note}"), *lines]) + "\n"
        message_name, places = self.names[declared.name.upper()], tuple(compiled.places)
        return Converted(message_name, text, *compiled.end(), compiled.least_pack, sure, places)

    def _base(self, declared: Declaration) -> Converted:
        """Return the layout of a structure that another structure extends.

        Raises NotConvertible if this base structure cannot be a message.
        """
        result = self.convert(declared)
        if isinstance(result, NotConvertible):
            raise _PartNotConvertible(declared)
        return result

    def _layout(self, field: types.Field) -> Converted:
        """Return the layout of a member's type, or of one element if the member is an array."""
        result = self.done[field.element.upper()] if field.element else None
        if isinstance(result, Converted):
            return result
        return Converted("", "", field.size, field.alignment)

    def _check_pack(self, declared: Declaration, field: types.Field, layout: Converted) -> None:
        """Raise NotConvertible if the structure's pack_mode might remove padding inside the type of one of its members.

        The member has the type `field`, with the layout `layout`.
        """
        if layout.least_pack > declared.pack > 0:
            reason = f"{declared.name} has pack_mode {declared.pack}, but the type {field.element} of a member has none"
            hint = f"give {field.element} the attribute too: no test shows whether the compiler packs it without one"
            raise NotConvertible(reason, hint)

    def _line(self, declared: Declaration) -> list[Declaration]:
        """Return all structures that `declared` extends, directly or indirectly, from the first base to `declared`."""
        line = [declared]
        while base := line[-1].extends:
            base_type = self._find(base)
            if base_type is None:
                raise NotConvertible(
                    f"{declared.name} extends {base}, which is not a data type of this project", _IMPORT, "SHM602"
                )
            if any(it.name.upper() == base_type.name.upper() for it in line):
                raise NotConvertible(f"{declared.name} extends itself", "remove one EXTENDS", "SHM301")
            if base_type.name.upper() in self.conflicts:
                raise _PartNotConvertible(base_type)
            if base_type.kind != "struct":
                raise NotConvertible(
                    f"{declared.name} extends {base}, which is not a structure",
                    "extend a structure, or list the members",
                )
            line.append(base_type)
            if len(line) > _DEEPEST:
                raise NotConvertible(f"more than {_DEEPEST} levels of EXTENDS", "remove some levels", "SHM304")
        self.members += sum(len(it.members) for it in line)
        if self.members > MOST:
            raise NotConvertible(
                f"more than {MOST:,} members in total, including members of bases", "import fewer types", "SHM303"
            )
        return line[::-1]

    def _find(self, name: str) -> Declaration | None:
        """Return the data type called `name`, or None. A namespace before the name is ignored."""
        return self.declared.get(name.rpartition(".")[2].upper())

    def _enumeration(self, declared: Declaration) -> Converted:
        base = declared.base.upper() or "INT"
        if base not in types.SCALARS or base in ("BOOL", "REAL", "LREAL", "TIME"):
            raise NotConvertible(
                f"{declared.name} is an enumeration of base type {declared.base}", "choose an integer as its base type"
            )
        type_, size = types.SCALARS[base].type, types.SCALARS[base].size
        values = self.numbers.of(declared)
        names = unique([snake(member.name).upper() for member in declared.members])
        lines = []
        for member, name in zip(declared.members, names, strict=True):
            value = values[member.name.upper()]
            if not types.fits(value, type_, size):
                raise NotConvertible(
                    f"{declared.name}.{member.name} is {value}, which is out of range for {base}",
                    "choose a larger base type",
                )
            own = "" if name == member.name else f"(PLC: {member.name})"
            lines += commented(f"{type_} {name}={value}", member.comment, own)
        text = [*head(declared, f"PLC: {declared.name} : {base}"), *lines, f"{type_} value"]
        return Converted(self.names[declared.name.upper()], "\n".join(text) + "\n", size, size)

    def _alias(self, declared: Declaration) -> Converted | NotConvertible:
        """Convert an alias to a structure with one member of the same bytes."""
        inner = Member("value", declared.base, "", "", declared.span)
        result = self._structure(declared._replace(kind="struct", members=(inner,), extends="", pack=0))
        if isinstance(result, NotConvertible):
            return result
        return result._replace(
            text=result.text.replace(f"(PLC: {declared.name})", f"(PLC: {declared.name} : alias)", 1)
        )

    def _names_of(self, name: str) -> tuple[str, str]:
        """Return the name of a data type in ROS, and its name in the PLC.

        Raises NotConvertible if the project does not declare the type, or if the type cannot be a message.
        """
        declared = self._find(name) if _NAME.fullmatch(name) else None
        if declared is None:
            raise self._undeclared_error(name)
        if declared.name.upper() in self.path:
            raise NotConvertible(
                f"{declared.name} contains itself", "remove one member: a message cannot contain itself", "SHM301"
            )
        if len(self.path) > _DEEPEST:
            raise NotConvertible(f"more than {_DEEPEST} nested structures", "import only an inner structure", "SHM304")
        if isinstance(self.convert(declared), NotConvertible):
            raise _PartNotConvertible(declared)
        return self.names[declared.name.upper()], declared.name

    def _undeclared_error(self, name: str) -> NotConvertible:
        """Return the error for a type that the project does not declare, with a similar name as a hint.

        Finding a similar name takes long, so only the first errors get this hint.
        """
        message, hint = f"{name} is not a data type of this project", _IMPORT
        if ("SHM602", message.upper()) not in self.faults and len(self.faults) < _MOST_HINTS:
            similar = types.intended(name, self.declared.keys() - set(self.path))
            similar = self.declared[similar].name if similar in self.declared else similar
            hint = f"did you mean {similar}?" if similar else _IMPORT
        return NotConvertible(message, hint, "SHM602")

    def _remember(self, error: NotConvertible, declared: Declaration, member: Member | None) -> NotConvertible:
        """Store an error with its position for diagnostics(), and return the error.

        If the error is only that a contained type cannot be a message, store nothing: that type has its own error.
        """
        if not isinstance(error, _PartNotConvertible):
            where = f"{declared.name}.{member.name}" if member else declared.name
            place = _Place(member.span if member else declared.span, where)
            self.faults.setdefault((error.code, error.message.upper()), (error, []))[1].append(place)
        return error


_NAME = re.compile(r"[^\W\d]\w*(?:\.[^\W\d]\w*)*")
_IMPORT = (
    "also import the file that declares it; a function block or a type of a library cannot be imported: copy its "
    "values into a structure of yours"
)


class _PartNotConvertible(NotConvertible):
    """A structure cannot be a message because it contains or extends a type that cannot be a message."""

    def __init__(self, declared: Declaration) -> None:
        super().__init__(f"it contains {declared.name}, which is left out", f"correct {declared.name} first")
