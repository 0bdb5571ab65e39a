"""Generate one Structured Text file for matiec, with the C code of its blocks, and a program that calls the blocks.

OpenPLC v3 reads C code from lines `(*FILE:path text*)` of the uploaded file. For Beremiz, these lines are comments:
the user passes the header `<package>.h` with the C code to the C compiler instead.
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import NamedTuple

from shmgen.core.diagnostics import Report
from shmgen.core.model import Output
from shmgen.targets import Job
from shmgen.targets.openplc import embedded, names, program
from shmgen.targets.openplc.blocks import Block
from shmgen.targets.openplc.compiler import MATIEC
from shmgen.targets.openplc.types import SECONDS, Structure, ordered, structure
from shmgen.targets.st.names import ST_TIME

NAMES = names.names("matiec")


class Library(NamedTuple):
    """The template data for the files `<package>.st` and `upload.st`.

    `files` are lines such as `(*FILE:path text*)`, which contain the blocks' C code. Only `upload.st` has a `program`.
    """

    package: str
    files: tuple[str, ...]
    structures: tuple[Structure, ...]
    blocks: tuple[Block, ...]
    program: program.Program | None


class Header(NamedTuple):
    package: str
    lines: tuple[str, ...]


def plan(job: Job, report: Report) -> Iterator[Output]:
    """Yield `matiec/<package>.st` and `matiec/<package>.h`.

    If shmgen.toml names topics, services or actions, also yield `matiec/upload.st`.
    """
    MATIEC.check(job.layouts, "matiec", report)
    if report.diagnostics:
        return
    whole = program.blocks(job, MATIEC)
    lines = (*_header(job), *(line for block in whole for line in _long(block)), "#endif")
    structures = [structure(layout, MATIEC) for layout in ordered(job.layouts)]
    if any(layout.options.time == "struct" for layout in ordered(job.layouts)):
        structures.insert(0, Structure(ST_TIME, "a ROS time or duration", SECONDS))
    blocks = [block._replace(body=(macro,)) if (macro := _body_macro(block)) else block for block in whole]
    files = tuple(f"(*FILE:c_blocks.h {_in_comment(line)} *)" for line in lines)
    view = Library(job.package, files, tuple(structures), tuple(blocks), None)
    yield Output(f"matiec/{job.package}.h", "matiec/header.h.j2", Header(job.package, lines))
    yield Output(f"matiec/{job.package}.st", "matiec/library.st.j2", view)
    plc_program = program.plan(job, MATIEC, whole)
    if plc_program:
        view = view._replace(structures=(*structures, *plc_program.structures), program=plc_program)
        yield Output("matiec/upload.st", "matiec/library.st.j2", view)


_TM = ("#ifdef _IEC_STD_LIB_H", "#define tm shmgen_tm", "#endif", "#ifdef _IEC_STD_LIB_H", "#undef tm", "#endif")


LONGEST = 8000
"""The largest body in characters. iec2c reads a body at once into a buffer of 16 KiB."""


def _body_macro(block: Block) -> str:
    """Return the name of the C macro for a block's body. Return `""` if matiec accepts the body without a macro.

    A body that is longer than LONGEST characters needs a macro.
    """
    return f"SHMGEN_BODY_{block.name.upper()}" if sum(map(len, block.body)) > LONGEST else ""


def _header(job: Job) -> Iterator[str]:
    code = embedded.code(job)
    yield "#ifndef SHMGEN_BLOCKS_H"
    yield "#define SHMGEN_BLOCKS_H"
    yield "#ifndef _GNU_SOURCE"
    yield "#define _GNU_SOURCE"
    yield "#endif"
    yield from _TM[:3]  # the header of OpenPLC v3 that includes this one has its own type `tm`
    yield from (f"#include <{name}>" for name in code.includes)
    yield from _TM[3:]
    yield from code.protocol
    for layout in ordered(job.layouts):
        yield from code.messages[layout.name]


def _long(block: Block) -> Iterator[str]:
    if macro := _body_macro(block):
        *lines, last = f"#define {macro}", *block.body
        yield from (f"{line} \\" for line in lines)
        yield last


def _in_comment(line: str) -> str:
    """Return a line of C for a comment of Structured Text: it cannot end the comment or begin another one.

    A blank splits `(*` and `*)`. No string in the C code contains these marks, so the code keeps its meaning.
    """
    return line.replace("(*", "( *").replace("*)", "* )")
