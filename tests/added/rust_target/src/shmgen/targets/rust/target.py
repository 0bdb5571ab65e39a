"""Turns layouts into a Rust crate of structures that assert their size and every offset when they are compiled."""

from __future__ import annotations

from collections.abc import Iterator
from itertools import groupby
from pathlib import PurePosixPath
from typing import NamedTuple

from shmgen.core.diagnostics import Report
from shmgen.core.model import (
    Clock,
    Constant,
    Element,
    Layout,
    Output,
    Ref,
    Role,
    Scalar,
    String,
    TypeName,
    TypeOptions,
    assert_never,
)
from shmgen.targets import Job
from shmgen.targets.rust.names import NAMES as NAMES
from shmgen.targets.rust.names import file, module, rust_name

_CLOCKS = {"TIME": "u32", "LTIME": "u64", "struct": "[u32; 2]"}


class Row(NamedTuple):
    """A field with its offset, or a constant with its value; `comment` stands beside it."""

    name: str
    type: str
    value: str
    comment: str


class Message(NamedTuple):
    title: str
    origin: str
    doc: tuple[str, ...]
    name: str
    size: str
    digest: str
    constants: tuple[Row, ...]
    fields: tuple[Row, ...]


class File(NamedTuple):
    """A module in a file of its own, and the structure in it."""

    module: str
    name: str


class Folder(NamedTuple):
    """A package with its kinds, or a kind with its files."""

    name: str
    folders: tuple[Folder, ...]
    files: tuple[File, ...]


def plan(job: Job, report: Report) -> Iterator[Output]:
    """Yield `rust/<package>/lib.rs`, and a file for each message."""
    root = f"rust/{job.package}"
    yield Output(f"{root}/lib.rs", "rust/lib.rs.j2", Folder(job.package, tuple(_packages(sorted(job.layouts))), ()))
    for name, layout in job.layouts.items():
        yield Output(f"{root}/{file(name)}", "rust/message.rs.j2", _message(layout))


def _packages(names: list[TypeName]) -> Iterator[Folder]:
    for package, members in groupby(names, key=lambda name: rust_name(name.package)):
        kinds = groupby(members, key=lambda name: name.kind)
        yield Folder(package, tuple(Folder(kind, (), tuple(map(_file, files))) for kind, files in kinds), ())


def _file(name: TypeName) -> File:
    return File(PurePosixPath(file(name)).stem, rust_name(name.name))


def _message(layout: Layout) -> Message:
    options = layout.options
    constants = [Row(rust_name(it.name), *_literal(it, options), _beside(it.doc)) for it in layout.message.constants]
    fields = []
    for slot in layout.slots:
        element = _type(slot.type, options)
        many = element if slot.count is None else f"[{element}; {slot.count}]"
        own = slot.field if slot.role is Role.DATA else None
        comment = f"[{own.unit}] {own.doc}" if own and own.unit else own.doc if own else slot.role.value
        fields.append(Row(rust_name(slot.name), many, str(slot.offset), _beside(comment)))
    return Message(
        title=str(layout.name),
        origin=_comment(layout.message.origin),
        doc=tuple(map(_comment, layout.message.doc.splitlines())),
        name=rust_name(layout.name.name),
        size=str(layout.size),
        digest=f"0x{layout.digest:016X}",
        constants=tuple(constants),
        fields=tuple(fields),
    )


def _type(type_: Element, options: TypeOptions) -> str:
    match type_:
        case Scalar.BOOL:
            return "u8"
        case Scalar():
            return str(type_.value).replace("uint", "u").replace("int", "i").replace("float", "f")
        case Clock():
            return _CLOCKS[options.time]
        case String(capacity, wide):
            return f"[{'u16' if wide else 'u8'}; {(capacity or 0) + 1}]"
        case Ref(name):
            return f"{module(name)}::{rust_name(name.name)}"
        case _:
            assert_never(type_)


def _literal(constant: Constant, options: TypeOptions) -> tuple[str, str]:
    """Return the type and the value of a constant."""
    value = constant.value
    if isinstance(constant.type, String) and constant.type.wide:
        data = str(value).encode("utf-16-le")
        return "&[u16]", f"&[{', '.join(str(data[at] + 256 * data[at + 1]) for at in range(0, len(data), 2))}]"
    if isinstance(constant.type, String):
        text = str(value).encode(options.encoding)
        plain = (chr(byte) if chr(byte).isascii() and chr(byte).isalnum() else f"\\x{byte:02x}" for byte in text)
        return "&[u8]", f'b"{"".join(plain)}"'
    kind = _type(constant.type, options)
    if constant.type.is_float:
        known = {"inf": f"{kind}::INFINITY", "-inf": f"-{kind}::INFINITY", "nan": f"{kind}::NAN"}
        return kind, known.get(repr(float(value)), repr(float(value)))
    return kind, str(int(value))


def _beside(text: str) -> str:
    return f" // {_comment(text)}" if text else ""


def _comment(text: str) -> str:
    """Return one line of printable characters: only the end of the line ends a comment in Rust."""
    return "".join(char if char.isprintable() else " " for char in text).strip()
