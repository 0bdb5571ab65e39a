"""Finds the files of a PLC project that declare data types: PLCopen XML, .TcDUT and .TcGVL, and plain .st."""

from __future__ import annotations

import codecs
from collections.abc import Iterable
from pathlib import Path

from shmgen.core import files
from shmgen.core.diagnostics import Report, Span
from shmgen.core.escape import legible
from shmgen.plc import declarations, exports
from shmgen.plc.declarations import MOST, Declared, Member, Unreadable
from shmgen.plc.numbers import Constant

SUFFIXES = (".xml", ".st", ".tcdut", ".tcgvl")
LARGEST_FILE = 64 * 2**20
"""Bytes; the largest export of a whole project that is known to us has 12 MiB."""


class Project:
    """The types in order, and the constants that bounds may name.

    `twice` has, by its name in capital letters, the second of two types that differ.
    """

    def __init__(self) -> None:
        self.types: list[Declared] = []
        self.constants: list[Constant] = []
        self.twice: dict[str, Declared] = {}
        self._known: dict[str, Declared] = {}
        self._members = 0

    def take(self, types: Iterable[Declared], owner: str, constants: Iterable[Member]) -> None:
        """A type that is there already, as in the export of one application beside another, counts once.

        `owner` is the list of the constants, if that is said. Raises Unreadable.
        """
        for it in types:
            self._count(len(it.members), it.span)
            former = self._known.setdefault(it.name.upper(), it)
            if former is it:
                self.types.append(it)
            elif _said(former) != _said(it):
                self.twice.setdefault(it.name.upper(), it)
        for one in constants:
            self._count(1, one.span)
            self.constants.append(Constant(owner, one.name, one.value, one.span))

    def _count(self, members: int, span: Span) -> None:
        self._members += members
        if self._members > MOST:
            raise Unreadable(f"more than {MOST:,} members in all", span)


def _said(declared: Declared) -> tuple[object, ...]:
    """What two of a name differ in."""
    members = [(it.name.upper(), it.type.upper(), it.value.upper()) for it in declared.members]
    return declared.kind, declared.base.upper(), declared.extends.upper(), declared.pack, members


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
            _read(file, legible(file.as_posix()), project, report)
    return project


def _below(path: Path) -> list[Path]:
    if path.is_dir():
        return sorted(it for it in path.rglob("*") if it.suffix.lower() in SUFFIXES and it.is_file())
    return [path] if path.is_file() else []


def _read(file: Path, shown: str, project: Project, report: Report) -> None:
    def tell(error: Unreadable) -> None:
        report.error("SHM003", error.message, error.span, hint=_HINT)

    try:
        with files.opened(file) as opened:
            data = opened.read(LARGEST_FILE + 1)
        if len(data) > LARGEST_FILE:
            report.error("SHM001", f"larger than {LARGEST_FILE >> 20} MiB", Span(shown))
            return
        if _is_xml(data):
            for owner, types, constants in exports.read(data, shown, tell):
                project.take(types, owner, constants)
        else:
            types, constants = declarations.read(_decoded(data, shown), shown)
            project.take(types, "", constants)
    except OSError as error:
        report.error("SHM001", f"cannot read: {error.strerror}", Span(shown))
    except Unreadable as error:
        tell(error)


_HINT = "is it what your IDE exports and compiles? --skip leaves out such files"
_UTF16 = (codecs.BOM_UTF16_LE, codecs.BOM_UTF16_BE)


def _is_xml(data: bytes) -> bool:
    """By its first character, behind marks and blanks."""
    return data[:99].lstrip(b"\xef\xbb\xbf\xfe\xff\0 \t\r\n").startswith(b"<")


def _decoded(data: bytes, shown: str) -> str:
    """As IDEs save: UTF-8, UTF-16 with its mark, or the code page of western Windows. Raises Unreadable."""
    try:
        text = data.decode("utf-16" if data.startswith(_UTF16) else "utf-8-sig")
    except UnicodeDecodeError:
        if data.startswith(_UTF16):
            raise Unreadable("not UTF-16, as its first bytes say", Span(shown)) from None
        text = data.decode("cp1252", errors="replace")
    return text.replace("\r\n", "\n")
