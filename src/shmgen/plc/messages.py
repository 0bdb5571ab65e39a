"""Writes the data types of a PLC project as .msg files of one ROS package.

A structure becomes a message, an enumeration one with its names as constants and the field `value`; what is called
otherwise in ROS keeps its own name in a comment, `(PLC: rSpeed)`, which Structured Text generated from it takes.
"""

from __future__ import annotations

import re
from typing import NamedTuple

from shmgen.core.diagnostics import Diagnostic, Report, Span
from shmgen.core.plural import counted
from shmgen.plc import package as around
from shmgen.plc import types
from shmgen.plc.declarations import MOST, Declared, Member
from shmgen.plc.names import of_messages, snake, unique
from shmgen.plc.numbers import Nothing, Numbers
from shmgen.plc.sources import Project


class Row(NamedTuple):
    """One data type: what it is called in ROS, and its bytes; or `why` it cannot be there.

    `sure` is said of the bytes: those of an empty structure, and behind a base that ends in padding, are not verified.
    """

    declared: Declared
    message: str
    size: int
    sure: bool = True
    why: str = ""


class Imported(NamedTuple):
    """`texts` are the files of the package; a type that cannot be a message is told in the report."""

    texts: dict[str, str]
    rows: list[Row]


def messages(project: Project, package: str, report: Report) -> Imported:
    """SHM601 for what ROS cannot hold, SHM602 for what the project does not declare, SHM301 for a circle.

    What is too large is SHM303, what is nested too deeply SHM304, and a name with two meanings SHM201.
    """
    work = _Work(project)
    rows, texts = [], {}
    for declared in project.types:
        made = work.made(declared)
        if isinstance(made, Nothing):
            rows.append(Row(declared, "", 0, why=made.message))
        else:
            rows.append(Row(declared, made.name, made.size, made.sure))
            texts[f"msg/{made.name}.msg"] = made.text
    report.diagnostics += work.diagnostics()
    if texts:
        times = any("builtin_interfaces/" in text for text in texts.values())
        texts |= {
            "package.xml": around.manifest(package, times),
            "CMakeLists.txt": around.cmake(package, sorted(texts), times),
        }
    return Imported(texts, rows)


class _Made(NamedTuple):
    name: str
    text: str
    size: int
    alignment: int
    packed: dict[int, tuple[int, int]]
    """pack_mode -> size and alignment there."""
    sure: bool = True


class _Place(NamedTuple):
    span: Span
    where: str


_PACKS = (1, 2, 4)
_NATURAL, _KEPT = 8, 16
"""Packed to so much nothing is; the second keeps the padding of a base, too."""
_DEEPEST = 50
"""Messages within messages, and bases of bases."""
_PLACES = 5
"""Of one fault, that are shown."""


class _Work:
    """Makes each message once, those that it holds before."""

    def __init__(self, project: Project) -> None:
        self.numbers = Numbers(project.constants, project.types)
        self.declared = {it.name.upper(): it for it in project.types}
        self.twice = project.twice
        self.names = of_messages([it.name for it in project.types])
        self.done: dict[str, _Made | Nothing] = {}
        self.path: list[str] = []
        self.members = 0
        self.faults: dict[tuple[str, str], tuple[Nothing, list[_Place]]] = {}

    def diagnostics(self) -> list[Diagnostic]:
        """One for each fault, with the places where it was met."""
        found = []
        for nothing, (first, *others) in self.faults.values():
            details = [f"also {it.where} ({it.span.path}:{it.span.line})" for it in others[:_PLACES]]
            if left := len(others[_PLACES:]):
                details.append(f"and {counted(left, 'place')} more")
            field = first.where if "." in first.where else ""
            found.append(Diagnostic(nothing.code, nothing.message, first.span, field, nothing.hint, tuple(details)))
        return found

    def made(self, declared: Declared) -> _Made | Nothing:
        key = declared.name.upper()
        if key not in self.done:
            self.path.append(key)
            try:
                self.done[key] = self._make(declared)
            except Nothing as nothing:
                self.done[key] = self._tell(nothing, declared, None)
            self.path.pop()
        return self.done[key]

    def _make(self, declared: Declared) -> _Made | Nothing:
        if other := self.twice.get(declared.name.upper()):
            places = f"{other.span.path}:{other.span.line}"
            hint = "import the project that has the one you mean; where both are needed, give one another name"
            raise Nothing(f"{declared.name} is declared otherwise in {places}", hint, "SHM201")
        match declared.kind:
            case "struct":
                return self._structure(declared)
            case "enum":
                return self._enumeration(declared)
            case "alias":
                return self._alias(declared)
        hint = "send the one of its members that counts, in a structure"
        raise Nothing(f"ROS has no union, which {declared.name} is", hint)

    def _structure(self, declared: Declared) -> _Made | Nothing:
        line = self._line(declared)
        members = [(member, it is not line[0] and place == 0) for it in line for place, member in enumerate(it.members)]
        names = unique([snake(member.name) for member, _ in members])
        lines: list[str] = []
        failed: Nothing | None = None
        sure = True
        sums = {pack: _Sum(pack) for pack in (_NATURAL, _KEPT, *_PACKS)}
        for (member, begins), name in zip(members, names, strict=True):
            if begins:
                sums[_KEPT].pad()
            try:
                field = types.field(member.type, self.numbers.value, self._named)
                sure = self._add(sums, field) and sure
            except Nothing as nothing:
                found = self._tell(nothing, declared, member)
                failed = failed or found
                continue
            lines += _field(name, member, field)
        if failed:
            return failed
        natural, packed = sums[_NATURAL], sums.get(declared.pack, sums[_NATURAL])
        if packed.all != natural.all:
            sizes = f"its {packed.end()[0]} bytes would be {natural.end()[0]}"
            hint = "copy what you share into a structure without the attribute"
            raise Nothing(f"{declared.name} has pack_mode {declared.pack}: {sizes}", hint)
        sure = sure and bool(lines) and sums[_KEPT].all == natural.all
        size, alignment = natural.end()
        name = self.names[declared.name.upper()]
        text = "\n".join([*_head(declared, f"PLC: {declared.name}"), *lines]) + "\n"
        return _Made(name, text, size, alignment, {pack: sums[pack].end() for pack in _PACKS}, sure)

    def _add(self, sums: dict[int, _Sum], field: types.Field) -> bool:
        """Whether its bytes are sure."""
        held = self.done[field.element.upper()] if field.element else None
        for pack, total in sums.items():
            if isinstance(held, _Made):
                size, alignment = held.packed.get(pack, (held.size, held.alignment))
                total.add(size, alignment, field.many)
            else:
                total.add(field.size, field.alignment, field.many)
            if total.at > types.LARGEST:
                raise Nothing(f"more than {types.LARGEST:,} bytes", "share a part of it", "SHM303")
        return held.sure if isinstance(held, _Made) else True

    def _line(self, declared: Declared) -> list[Declared]:
        """The structure behind all its bases, the first of them first."""
        line = [declared]
        while base := line[-1].extends:
            found = self._find(base)
            if found is None:
                raise Nothing(f"no data type {base} is here, which {declared.name} extends", _IMPORT, "SHM602")
            if any(it.name.upper() == found.name.upper() for it in line):
                raise Nothing(f"{declared.name} extends itself", "take one EXTENDS away", "SHM301")
            if found.name.upper() in self.twice:
                raise _Held(found)
            if found.kind != "struct":
                raise Nothing(f"{declared.name} extends {base}, which is no structure", "write what it is made of")
            line.append(found)
            if len(line) > _DEEPEST:
                raise Nothing(f"more than {_DEEPEST} bases of each other", "take some of them out", "SHM304")
        self.members += sum(len(it.members) for it in line)
        if self.members > MOST:
            raise Nothing(f"more than {MOST:,} members in all, with those of bases", "import a part", "SHM303")
        return line[::-1]

    def _find(self, name: str) -> Declared | None:
        """By its name, whatever namespace stands before it."""
        return self.declared.get(name.rpartition(".")[2].upper())

    def _enumeration(self, declared: Declared) -> _Made:
        base = declared.base.upper() or "INT"
        if base not in types.SCALARS or base in ("BOOL", "REAL", "LREAL", "TIME"):
            raise Nothing(f"{declared.name} is an enumeration over {declared.base}", "ROS counts in whole numbers")
        type_, size = types.SCALARS[base]
        values = self.numbers.of(declared)
        names = unique([snake(member.name).upper() for member in declared.members])
        lines = []
        for member, name in zip(declared.members, names, strict=True):
            value = values[member.name.upper()]
            if not types.fits(value, type_, size):
                raise Nothing(f"{declared.name}.{member.name} is {value}, which {base} cannot hold", "widen its base")
            own = "" if name == member.name else f"(PLC: {member.name})"
            lines += _commented(f"{type_} {name}={value}", member.comment, own)
        text = [*_head(declared, f"PLC: {declared.name} : {base}"), *lines, f"{type_} value"]
        packed = {pack: (size, min(size, pack)) for pack in _PACKS}
        return _Made(self.names[declared.name.upper()], "\n".join(text) + "\n", size, size, packed)

    def _alias(self, declared: Declared) -> _Made | Nothing:
        """A structure with one member of the same bytes."""
        inner = Member("value", declared.base, "", "", declared.span)
        made = self._structure(declared._replace(kind="struct", members=(inner,), extends=""))
        if isinstance(made, Nothing):
            return made
        return made._replace(text=made.text.replace(f"(PLC: {declared.name})", f"(PLC: {declared.name} : alias)", 1))

    def _named(self, name: str) -> tuple[str, str]:
        """What it is called in ROS and in the PLC. Raises Nothing."""
        declared = self._find(name) if _NAME.fullmatch(name) else None
        if declared is None:
            raise Nothing(f"no data type {name} is here", _IMPORT, "SHM602")
        if declared.name.upper() in self.path:
            raise Nothing(f"{declared.name} holds itself", "a message cannot: take one of the members out", "SHM301")
        if len(self.path) > _DEEPEST:
            raise Nothing(f"more than {_DEEPEST} structures in each other", "share a part of it", "SHM304")
        if isinstance(self.made(declared), Nothing):
            raise _Held(declared)
        return self.names[declared.name.upper()], declared.name

    def _tell(self, nothing: Nothing, declared: Declared, member: Member | None) -> Nothing:
        """What is held and at fault is told where it is, and not again."""
        if not isinstance(nothing, _Held):
            where = f"{declared.name}.{member.name}" if member else declared.name
            place = _Place(member.span if member else declared.span, where)
            self.faults.setdefault((nothing.code, nothing.message.upper()), (nothing, []))[1].append(place)
        return nothing


_NAME = re.compile(r"[A-Za-z_]\w*(?:\.[A-Za-z_]\w*)*")
_IMPORT = "import what declares it too; of a function block or a library's type send the values that count"


class _Held(Nothing):
    """That a structure holds one that cannot be a message."""

    def __init__(self, declared: Declared) -> None:
        super().__init__(f"it holds {declared.name}, which is left out", "mend that one first")


class _Sum:
    """Where the next member goes, in a structure packed to at most so many bytes."""

    def __init__(self, pack: int) -> None:
        self.pack, self.at, self.most = pack, 0, 1
        self.places: list[int] = []

    def add(self, size: int, alignment: int, many: int) -> None:
        alignment = min(alignment, self.pack)
        self.at = -(-self.at // alignment) * alignment
        self.places.append(self.at)
        self.at += size * (many or 1)
        self.most = max(self.most, alignment)

    def pad(self) -> None:
        """What comes next begins where an array of this would have its second element."""
        self.at = self.end()[0]

    @property
    def all(self) -> tuple[list[int], int]:
        return self.places, self.end()[0]

    def end(self) -> tuple[int, int]:
        return -(-max(self.at, 1) // self.most) * self.most, self.most


def _head(declared: Declared, own: str) -> list[str]:
    lines = [line for line in declared.comment.split("\n") if line]
    return [*(f"# {_harmless(line)}" for line in lines), f"# ({own})", ""]


def _field(name: str, member: Member, field: types.Field) -> list[str]:
    value = _default(member, field)
    left = "" if value or not member.value else f"initial value {member.value}"
    said = "\n".join(filter(None, [member.comment, left and _harmless(left)]))
    if field.says and "[" not in said:
        said = f"{said} [{field.says}]" if re.fullmatch(r"\w+", field.says) else f"{said} {field.says}"
    own = f"(PLC: {member.name} : {field.own})" if field.own else "" if name == member.name else f"(PLC: {member.name})"
    return _commented(f"{field.type} {name}{value and f' {value}'}", said.strip(), own)


def _commented(code: str, comment: str, own: str) -> list[str]:
    """The comment beside it if it has one line, else above."""
    lines = [_harmless(line) for line in comment.split("\n") if line]
    if len(lines) > 1:
        return [*(f"# {line}" for line in lines), f"{code}  # {own}" if own else code]
    beside = " ".join(filter(None, [*lines, own]))
    return [f"{code}  # {beside}" if beside else code]


def _harmless(line: str) -> str:
    """That says nothing to the reader of definitions: no control characters, and no `(PLC: …)` of its own."""
    return "".join(c if c.isprintable() else " " for c in line).replace("(PLC:", "(plc:").strip()


_FLOAT = re.compile(r"(?:[A-Za-z_]\w*#)?([-+]?\d[\d_]{0,40}(?:\.[\d_]{1,40})?(?:[eE][-+]?\d{1,3})?)", re.ASCII)
_LARGEST_FLOAT = {4: 3.4028234e38, 8: 1.7976931348623157e308}
_WITHOUT_CONSTANTS = Numbers((), ())


def _default(member: Member, field: types.Field) -> str:
    """Of a number, a BOOL or a string; else nothing."""
    text = member.value
    if not text or field.many or field.element or "/" in field.type:
        return ""
    if field.type == "bool":
        return {"TRUE": "true", "FALSE": "false", "1": "true", "0": "false"}.get(text.upper(), "")
    if "string" in field.type:
        inner = text[1:-1]
        room = int(field.type.partition("=")[2])
        plain = text == f"'{inner}'" and inner.isascii() and inner.isprintable() and not set("$\\'\"") & set(inner)
        return f'"{inner}"' if inner and plain and len(inner) <= room else ""
    if field.type.startswith("float"):
        value = found[1].replace("_", "") if (found := _FLOAT.fullmatch(text)) else ""
        return value if value and abs(float(value)) <= _LARGEST_FLOAT[field.size] else ""
    try:
        number = _WITHOUT_CONSTANTS.value(text)
    except Nothing:
        return ""
    return str(number) if types.fits(number, field.type, field.size) else ""
