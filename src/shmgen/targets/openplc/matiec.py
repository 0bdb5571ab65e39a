"""Turns layouts into one file of Structured Text for matiec, with the C that its blocks call, and a program.

OpenPLC v3 takes C from lines `(*FILE:path text*)` of the file that is uploaded; to Beremiz they are comments, and its
compiler is told the header's name.
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import NamedTuple

from shmgen.core.diagnostics import Report
from shmgen.core.model import Output
from shmgen.targets import Job
from shmgen.targets.openplc import embedded, limits, names, program
from shmgen.targets.openplc.blocks import Block
from shmgen.targets.openplc.compiler import MATIEC
from shmgen.targets.openplc.types import SECONDS, Structure, ordered, structure
from shmgen.targets.st.names import ST_TIME

NAMES = names.names("matiec")


class Library(NamedTuple):
    """`files` are the FILE lines; `program` is None in the file that holds no program."""

    package: str
    files: tuple[str, ...]
    structures: tuple[Structure, ...]
    blocks: tuple[Block, ...]
    has_program: bool
    program: program.Program | None


class Header(NamedTuple):
    package: str
    lines: tuple[str, ...]


def plan(job: Job, report: Report) -> Iterator[Output]:
    """`matiec/<package>.st`, `matiec/<package>.h`, and for what shmgen.toml names `matiec/upload.st`."""
    limits.check(job.layouts, MATIEC, "matiec", report)
    if report.diagnostics:
        return
    whole = program.blocks(job, MATIEC)
    lines = (*_header(job), *(line for block in whole for line in _long(block)), "#endif")
    structures = [structure(layout, MATIEC) for layout in ordered(job.layouts)]
    if any(layout.options.time == "struct" for layout in ordered(job.layouts)):
        structures.insert(0, Structure(ST_TIME, "a ROS time or duration", SECONDS))
    blocks = [_short(block) for block in whole]
    files = tuple(f"(*FILE:c_blocks.h {_in_comment(line)} *)" for line in lines)
    view = Library(job.package, files, tuple(structures), tuple(blocks), False, None)
    yield Output(f"matiec/{job.package}.h", "matiec/header.h.j2", Header(job.package, lines))
    yield Output(f"matiec/{job.package}.st", "matiec/library.st.j2", view)
    made = program.plan(job, MATIEC, whole)
    if made:
        view = view._replace(has_program=True, program=made)
        yield Output("matiec/upload.st", "matiec/library.st.j2", view)


_TM = ("#ifdef _IEC_STD_LIB_H", "#define tm shmgen_tm", "#endif", "#ifdef _IEC_STD_LIB_H", "#undef tm", "#endif")


LONGEST = 8000
"""Characters of a body: iec2c reads one at one go into a buffer of 16 KiB."""


def _body_macro(block: Block) -> str:
    """The name under which a body that is too long stands in the header, or nothing."""
    return f"SHMGEN_BODY_{block.name.upper()}" if sum(map(len, block.body)) > LONGEST else ""


def _short(block: Block) -> Block:
    macro = _body_macro(block)
    return block._replace(body=(macro,)) if macro else block


def _header(job: Job) -> Iterator[str]:
    texts = embedded.printed(job)
    shared = embedded.protocol(job, texts)
    yield "#ifndef SHMGEN_BLOCKS_H"
    yield "#define SHMGEN_BLOCKS_H"
    yield "#ifndef _GNU_SOURCE"
    yield "#define _GNU_SOURCE"
    yield "#endif"
    yield from _TM[:3]  # OpenPLC v3 includes this from a header that has called a type of its own `tm` by then
    yield from (f"#include <{name}>" for name in shared.includes)
    yield from _TM[3:]
    yield from shared.lines
    for layout in ordered(job.layouts):
        yield from embedded.message(layout, texts)


def _long(block: Block) -> Iterator[str]:
    if macro := _body_macro(block):
        *lines, last = f"#define {macro}", *block.body
        yield from (f"{line} \\" for line in lines)
        yield last


def _in_comment(line: str) -> str:
    """A line of C that neither ends the comment nor begins another; none of it is in quotes with such a sign."""
    return line.replace("(*", "( *").replace("*)", "* )")
