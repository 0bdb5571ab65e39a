"""Find and read the files of a PLC project: types in PLCopen XML, .TcDUT, .TcGVL and .st, and layouts in .tmc."""

from __future__ import annotations

import codecs
import errno
from collections.abc import Iterable
from pathlib import Path

from shmgen.core import files
from shmgen.core.diagnostics import Report, Span
from shmgen.core.escape import legible
from shmgen.plc import declarations, exports
from shmgen.plc.compiled import Compiled
from shmgen.plc.declarations import MOST, Declaration, Member, Unreadable
from shmgen.plc.numbers import Constant

SUFFIXES = (".xml", ".st", ".tcdut", ".tcgvl")
COMPILED = ".tmc"
"""The suffix of the file that TwinCAT writes when it builds a project: the size and offsets of each type."""
LARGEST_FILE = 64 * 2**20
"""The largest size of a file in bytes. The largest known export of a whole project has 12 MiB."""


class Project:
    """The data types of a PLC project in order, and the constants that its expressions may refer to.

    If two different types have the same name, `conflicts` contains the second type. `compiled` contains the layouts in
    .tmc files. The keys of `conflicts` and `compiled` are the names of types in capital letters.
    """

    def __init__(self) -> None:
        self.types: list[Declaration] = []
        self.constants: list[Constant] = []
        self.conflicts: dict[str, Declaration] = {}
        self.compiled: dict[str, list[Compiled]] = {}
        self._known: dict[str, Declaration] = {}
        self._members = 0

    def add(self, types: Iterable[Declaration], owner: str, constants: Iterable[Member]) -> None:
        """Add data types, and the constants of the list `owner`. `owner` is `""` if the list has no name.

        A type that is already present is ignored, because exports of two applications may share types. Raises
        Unreadable if the project is too large.
        """
        for it in types:
            self._count(len(it.members), it.span)
            former = self._known.setdefault(it.name.upper(), it)
            if former is it:
                self.types.append(it)
            elif _comparable(former) != _comparable(it):
                self.conflicts.setdefault(it.name.upper(), it)
        for one in constants:
            self._count(1, one.span)
            self.constants.append(Constant(owner, one.name, one.value, one.span))

    def _count(self, members: int, span: Span) -> None:
        self._members += members
        if self._members > MOST:
            raise Unreadable(f"more than {MOST:,} members in total", span)


def _comparable(declared: Declaration) -> tuple[object, ...]:
    """Return the parts of a type that must be equal in two declarations of the same name."""
    members = [(it.name.upper(), it.type.upper(), it.value.upper()) for it in declared.members]
    return declared.kind, declared.base.upper(), declared.extends.upper(), declared.pack, members


def read(paths: Iterable[Path], report: Report) -> Project:
    """Read files, and all files below folders. Report SHM001 or SHM003 for files that cannot be read."""
    project = Project()
    compiled: list[Path] = []
    for path in paths:
        files = [] if path.suffix.lower() in _UNREAD and path.is_file() else _files(path, (*SUFFIXES, COMPILED))
        if not files:
            _report_unreadable(path, report)
        layouts = [file for file in files if file.suffix.lower() == COMPILED]
        for file in (file for file in files if file not in layouts):
            _read(file, legible(file.as_posix()), project, report)
        compiled += (it.absolute() for it in (*layouts, *_beside_project(path)))
    for file in dict.fromkeys(compiled):
        _read_compiled(file, project, report)
    return project


def _report_unreadable(path: Path, report: Report) -> None:
    """Report SHM001 for a path without a readable file, with a hint about the files to give instead."""
    unread = _files(path, tuple(_UNREAD))
    reason = "nothing to import" if path.exists() else "no such file"
    hint = f"give a file or a folder with {', '.join(SUFFIXES)}"
    if unread:
        reason, hint = f"{legible(unread[0].name)} is a file of the IDE's own format", _UNREAD[unread[0].suffix.lower()]
    report.error("SHM001", reason, Span(str(path)), hint=hint)


_CODESYS = "open the project in CODESYS, choose Project > Export PLCopenXML, and give that file"
_TWINCAT = "give the folder of the TwinCAT project, with its .TcDUT files"
_UNREAD = {
    **dict.fromkeys((".project", ".projectarchive", ".export", ".library", ".compiled-library"), _CODESYS),
    **dict.fromkeys((".sln", ".tsproj", ".plcproj", ".tszip", ".tpzip", ".tnzip"), _TWINCAT),
}
"""Suffixes of files that an engineer would try first -> a hint about the files that shmgen can read."""


def _files(path: Path, suffixes: tuple[str, ...]) -> list[Path]:
    """Return `path` itself if it is a file, otherwise all files below the folder `path` with one of the suffixes."""
    if path.is_dir():
        return sorted(it for it in path.rglob("*") if it.suffix.lower() in suffixes and it.is_file())
    return [path] if path.is_file() else []


def _beside_project(path: Path) -> list[Path]:
    """Return the .tmc files in the folder of the TwinCAT project that a file or folder belongs to."""
    for folder in path.absolute().parents:
        try:
            names = sorted(it.name for it in folder.iterdir())
        except OSError:
            return []
        if any(name.lower().endswith(".plcproj") for name in names):
            return [folder / name for name in names if name.lower().endswith(COMPILED)]
    return []


def _read_compiled(file: Path, project: Project, report: Report) -> None:
    place = legible(file.as_posix())
    try:
        for name, compiled in exports.compiled(_contents(file), place, legible(file.name)):
            project.compiled.setdefault(name, []).append(compiled)
    except OSError as error:
        report.error("SHM001", f"cannot read: {error.strerror}", Span(place))
    except Unreadable as error:
        hint = "TwinCAT writes the file when it builds the project: build it again, or delete the file"
        report.error("SHM003", error.message, error.span, hint=hint)


def _read(file: Path, place: str, project: Project, report: Report) -> None:
    def tell(error: Unreadable) -> None:
        report.error("SHM003", error.message, error.span, hint=_HINT)

    try:
        data = _contents(file)
        if _is_xml(data):
            for owner, types, constants in exports.read(data, place, tell):
                project.add(types, owner, constants)
        else:
            types, constants = declarations.read(_decode(data, place), place)
            project.add(types, "", constants)
    except OSError as error:
        report.error("SHM001", f"cannot read: {error.strerror}", Span(place))
    except Unreadable as error:
        tell(error)


def _contents(file: Path) -> bytes:
    with files.open_file(file) as opened:
        data = opened.read(LARGEST_FILE + 1)
    if len(data) > LARGEST_FILE:
        raise OSError(errno.EFBIG, f"larger than {LARGEST_FILE >> 20} MiB")
    return data


_HINT = "check that your IDE compiles this file, or export it again; --skip leaves out such files"
_UTF16 = (codecs.BOM_UTF16_LE, codecs.BOM_UTF16_BE)


def _is_xml(data: bytes) -> bool:
    """Return True if a file is probably XML, because its first character is `<`.

    A byte order mark and blanks before this character are ignored.
    """
    return data[:99].lstrip(b"\xef\xbb\xbf\xfe\xff\0 \t\r\n").startswith(b"<")


def _decode(data: bytes, place: str) -> str:
    """Decode text in an encoding of the IDEs: UTF-8, UTF-16 with a byte order mark, or Windows-1252.

    Raises Unreadable if a file with the mark of UTF-16 is not UTF-16.
    """
    try:
        text = data.decode("utf-16" if data.startswith(_UTF16) else "utf-8-sig")
    except UnicodeDecodeError:
        if data.startswith(_UTF16):
            raise Unreadable("not UTF-16, although its first bytes announce it", Span(place)) from None
        text = data.decode("cp1252", errors="replace")
    return text.replace("\r\n", "\n")
