"""Turns the data types of a PLC project into .msg files of one ROS package.

A structure becomes a message, an enumeration one with its names as constants and the field `value`; what is called
otherwise in ROS keeps its own name in a comment, `(PLC: rSpeed)`, which Structured Text generated from it takes.
"""

from __future__ import annotations

import re
from typing import NamedTuple

from shmgen.core.diagnostics import Report
from shmgen.plc import types
from shmgen.plc.declarations import Declared, Member
from shmgen.plc.sources import Project
from shmgen.plc.types import Nothing, number


class Row(NamedTuple):
    """One data type: what it is called in ROS, empty if it cannot be there, and its bytes."""

    declared: Declared
    message: str
    size: int


class Imported(NamedTuple):
    """`texts` are the files of the package; a type that cannot be a message is told in the report."""

    texts: dict[str, str]
    rows: list[Row]


def messages(project: Project, package: str, report: Report) -> Imported:
    """SHM601 for what ROS cannot hold, SHM602 for what the project does not declare, SHM301 for a circle."""
    work = _Work(project, report)
    rows, texts = [], {}
    for declared in project.types:
        made = work.made(declared)
        if made is None:
            rows.append(Row(declared, "", 0))
        else:
            rows.append(Row(declared, made.name, made.size))
            texts[f"msg/{made.name}.msg"] = made.text
    if texts:
        times = any("builtin_interfaces/" in text for text in texts.values())
        texts |= {"package.xml": _manifest(package, times), "CMakeLists.txt": _cmake(package, sorted(texts), times)}
    return Imported(texts, rows)


class _Made(NamedTuple):
    name: str
    text: str
    size: int
    alignment: int
    packed: dict[int, tuple[int, int]]
    """pack_mode -> size and alignment there."""


_PREFIX = re.compile(r"(ST|E|EN|ENUM|DUT|T|TYP|U)_(?=[A-Za-z])", re.IGNORECASE)
_PACKS = (1, 2, 4)


class _Work:
    """Makes each message once, those that it holds before."""

    def __init__(self, project: Project, report: Report) -> None:
        self.constants, self.report = project.constants, report
        self.declared = {it.name.upper(): it for it in project.types}
        self.names = _message_names([it.name for it in project.types])
        self.done: dict[str, _Made | None] = {}
        self.path: list[str] = []

    def made(self, declared: Declared) -> _Made | None:
        key = declared.name.upper()
        if key not in self.done:
            self.path.append(key)
            try:
                self.done[key] = self._make(declared)
            except Nothing as nothing:
                self._tell(nothing, declared, None)
                self.done[key] = None
            self.path.pop()
        return self.done[key]

    def _make(self, declared: Declared) -> _Made | None:
        match declared.kind:
            case "struct":
                return self._structure(declared)
            case "enum":
                return self._enumeration(declared)
            case "alias":
                return self._alias(declared)
        hint = "send the one of its members that counts, in a structure"
        raise Nothing(f"ROS has no union, which {declared.name} is", hint)

    def _structure(self, declared: Declared) -> _Made | None:
        members = self._inherited(declared)
        names = _unique([_snake(member.name) for member in members])
        lines, failed = [], False
        natural, packed = _Sum(8), {pack: _Sum(pack) for pack in _PACKS}
        for member, name in zip(members, names, strict=True):
            try:
                field = types.field(member.type, self.constants, self._named)
            except Nothing as nothing:
                self._tell(nothing, declared, member)
                failed = True
                continue
            held = self.done[field.element.upper()] if field.element else None
            if held:
                natural.add(held.size, held.alignment, field.many)
                for pack, total in packed.items():
                    total.add(*held.packed[pack], field.many)
            else:
                for total in (natural, *packed.values()):
                    total.add(field.size, field.alignment, field.many)
            lines += _field(name, member, field)
        if failed:
            return None
        if declared.pack in packed and (packed[declared.pack].places, packed[declared.pack].end()[0]) != (
            natural.places,
            natural.end()[0],
        ):
            sizes = f"its {packed[declared.pack].end()[0]} bytes would be {natural.end()[0]}"
            hint = "copy what you share into a structure without the attribute"
            raise Nothing(f"{declared.name} has pack_mode {declared.pack}: {sizes}", hint)
        size, alignment = natural.end()
        name = self.names[declared.name.upper()]
        text = "\n".join([*_head(declared, f"PLC: {declared.name}"), *lines]) + "\n"
        return _Made(name, text, size, alignment, {pack: total.end() for pack, total in packed.items()})

    def _inherited(self, declared: Declared) -> list[Member]:
        members: list[Member] = []
        seen: set[str] = set()
        here: Declared | None = declared
        while here:
            if here.name.upper() in seen:
                raise Nothing(f"{declared.name} extends itself", "take one EXTENDS away", "SHM301")
            seen.add(here.name.upper())
            members = [*here.members, *members]
            base = here.extends
            here = self.declared.get(base.upper()) if base else None
            if base and here is None:
                raise Nothing(f"{declared.name} extends {base}, which is not here", "import it too", "SHM602")
        return members

    def _enumeration(self, declared: Declared) -> _Made:
        base = declared.base.upper() or "INT"
        if base not in types.SCALARS or base in ("BOOL", "REAL", "LREAL", "TIME"):
            raise Nothing(f"{declared.name} is an enumeration over {declared.base}", "ROS counts in whole numbers")
        type_, size = types.SCALARS[base]
        values, value = [], -1
        known = dict(self.constants)
        for member in declared.members:
            value = number(member.value, known) if member.value else value + 1
            known[member.name.upper()] = str(value)
            values.append(value)
        names = _unique([_snake(member.name).upper() for member in declared.members])
        lines = []
        for member, name, value in zip(declared.members, names, values, strict=True):
            own = "" if name == member.name else f"(PLC: {member.name})"
            lines += _commented(f"{type_} {name}={value}", member.comment, own)
        text = [*_head(declared, f"PLC: {declared.name} : {base}"), *lines, f"{type_} value"]
        packed = {pack: (size, min(size, pack)) for pack in _PACKS}
        return _Made(self.names[declared.name.upper()], "\n".join(text) + "\n", size, size, packed)

    def _alias(self, declared: Declared) -> _Made | None:
        """A structure with one member of the same bytes."""
        inner = Member("value", declared.base, "", "", declared.span)
        made = self._structure(declared._replace(kind="struct", members=(inner,)))
        if made is None:
            return None
        return made._replace(text=made.text.replace(f"(PLC: {declared.name})", f"(PLC: {declared.name} : alias)", 1))

    def _named(self, name: str) -> str:
        key = name.rpartition(".")[2].upper()
        declared = self.declared.get(key)
        if declared is None:
            hint = "import what declares it too; of a function block or a library's type send the values that count"
            raise Nothing(f"no data type {name} is here", hint, "SHM602")
        if key in self.path:
            raise Nothing(f"{name} holds itself", "a message cannot: take one of the members out", "SHM301")
        if self.made(declared) is None:
            raise Nothing(f"{name} cannot be a message", "mend that one first", "")
        return self.names[key]

    def _tell(self, nothing: Nothing, declared: Declared, member: Member | None) -> None:
        """What is held and at fault is told where it is; here it is told again, as that one is no message either."""
        span = member.span if member else declared.span
        where = f"{declared.name}.{member.name}" if member else declared.name
        self.report.error(nothing.code or "SHM601", nothing.message, span, field=where, hint=nothing.hint)


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


_TYPED = re.compile(r"(?:[A-Za-z_]\w*#)?([-+]?[\d_.]+(?:[eE][-+]?\d+)?)")


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
        plain = inner.isascii() and inner.isprintable() and not set("$\\'\"") & set(inner)
        return f'"{inner}"' if inner and plain and len(inner) <= room else ""
    if field.type.startswith("float"):
        return found[1].replace("_", "") if (found := _TYPED.fullmatch(text)) else ""
    try:
        value = number(text, {})
    except Nothing:
        return ""
    bits = 8 * field.size
    least, most = (0, 2**bits) if field.type.startswith("u") else (-(2 ** (bits - 1)), 2 ** (bits - 1))
    return str(value) if least <= value < most else ""


_WORDS = re.compile(r"[A-Z]+(?![a-z])\d*|[A-Z]?[a-z]+\d*|\d+")


def _snake(name: str) -> str:
    """`rActPos` -> `r_act_pos`, `nAxisID` -> `n_axis_id`, `IDLE` -> `idle`."""
    words = "_".join(_WORDS.findall(name)).lower() or "x"
    return words if words[0].isalpha() else f"n{words}"


def _camel(name: str) -> str:
    words = re.findall(r"[A-Za-z0-9]+", name)
    whole = "".join(
        word.capitalize() if word.isupper() or word.islower() else word[0].upper() + word[1:] for word in words
    )
    return whole if whole[:1].isalpha() else f"N{whole}"


def _message_names(names: list[str]) -> dict[str, str]:
    """Without the prefix where that is enough to tell them apart."""
    short = {name.upper(): _camel(_PREFIX.sub("", name, count=1)) for name in names}
    often = [it.upper() for it in short.values()]
    kept = [
        it if often.count(it.upper()) == 1 else _camel(name) for name, it in zip(names, short.values(), strict=False)
    ]
    return dict(zip(short, _unique(kept), strict=True))


def _unique(names: list[str]) -> list[str]:
    """A number behind each that is there already; ROS tells cases apart, Structured Text does not."""
    seen: set[str] = set()
    found = []
    for name in names:
        other, count = name, 2
        while other.upper() in seen:
            other = f"{name}{'' if name[0].isupper() and '_' not in name else '_'}{count}"
            count += 1
        seen.add(other.upper())
        found.append(other)
    return found


def _manifest(package: str, times: bool) -> str:
    depend = "  <depend>builtin_interfaces</depend>\n" if times else ""
    return f"""<?xml version="1.0"?>
<package format="3">
  <name>{package}</name>
  <version>0.0.0</version>
  <description>Data types of a PLC project</description>
  <maintainer email="nobody@localhost">nobody</maintainer>
  <license>unknown</license>
  <buildtool_depend>ament_cmake</buildtool_depend>
  <buildtool_depend>rosidl_default_generators</buildtool_depend>
{depend}  <exec_depend>rosidl_default_runtime</exec_depend>
  <member_of_group>rosidl_interface_packages</member_of_group>
  <export>
    <build_type>ament_cmake</build_type>
  </export>
</package>
"""


def _cmake(package: str, files: list[str], times: bool) -> str:
    listed = "\n".join(f"  {file}" for file in files)
    find, depend = (
        ("find_package(builtin_interfaces REQUIRED)\n", " DEPENDENCIES builtin_interfaces") if times else ("", "")
    )
    return f"""cmake_minimum_required(VERSION 3.8)
project({package})
find_package(ament_cmake REQUIRED)
find_package(rosidl_default_generators REQUIRED)
{find}rosidl_generate_interfaces(${{PROJECT_NAME}}
{listed}
 {depend})
ament_package()
"""
