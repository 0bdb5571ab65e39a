"""Turns layouts into a library of OpenPLC v4 (`.stlib`, JSON with C++ in it), and a program that uses it.

The library holds one chunk for each type and block, which says what it needs; a program gets those that it reaches. The
form is that of STruC++ 0.6.1, src/library/library-manifest.ts.
"""

from __future__ import annotations

import json
from collections.abc import Iterable, Iterator
from typing import NamedTuple

from shmgen.diagnostics import Report
from shmgen.model import Output
from shmgen.targets import Job
from shmgen.targets.openplc import embedded, limits, names, program
from shmgen.targets.openplc.blocks import Block, Variable, pair
from shmgen.targets.openplc.dialect import STRUCPP
from shmgen.targets.openplc.spelling import cpp_type, cpp_value, manifest_type
from shmgen.targets.openplc.types import SECONDS, Structure, ordered, structure
from shmgen.targets.st.names import ST_TIME

NAMES = names.capital_names("OpenPLC")
PROTOCOL = "SHMGEN_PROTOCOL"
"""The chunk that every block needs."""


class Library(NamedTuple):
    """The text of the file."""

    text: str


class Program(NamedTuple):
    program: program.Program


def plan(job: Job, report: Report) -> Iterator[Output]:
    """`openplc/<package>.stlib`, and where there are topics `openplc/PRG_Ros.st`."""
    limits.check(job.layouts, STRUCPP, "openplc", report)
    if report.diagnostics:
        return
    made = program.plan(job, STRUCPP)
    yield Output(f"openplc/{job.package}.stlib", "openplc/library.stlib.j2", Library(_library(job, made)))
    if made:
        yield Output(f"openplc/{names.PROGRAM}.st", "openplc/program_file.st.j2", Program(made))


def _library(job: Job, made: program.Program | None) -> str:
    layouts = ordered(job.layouts)
    protocol = embedded.protocol(job)
    blocks = [block for layout in program.carried(job) for block in pair(layout, job.layouts, STRUCPP)]
    own = [Structure(ST_TIME, "", SECONDS)] if any(layout.options.time == "struct" for layout in layouts) else []
    carried = {structure(layout, STRUCPP): embedded.message(layout, job) for layout in layouts}
    every = {**dict.fromkeys(own, ()), **carried, **dict.fromkeys(made.structures if made else (), ())}
    known = {one.name.upper() for one in every}
    chunks = [_chunk(job.package, PROTOCOL, "type", protocol.lines, (), ())]
    for one, lines in every.items():
        needs = [*([PROTOCOL] if lines else []), *_needs(one.members, known)]
        chunks.append(_chunk(job.package, one.name.upper(), "type", (*lines, *_structure(one)), (), needs))
    for block in blocks:
        needs = [PROTOCOL, *_needs((*block.inputs, *block.outputs), known)]
        chunks.append(_chunk(job.package, block.name.upper(), "functionBlock", _class(block), _body(block), needs))
    manifest = {
        "name": job.package,
        "description": "Made by shmgen; changes made here are lost. Messages of ROS in shared memory.",
        "version": "1.0.0",
        "namespace": job.package,
        "functions": [],
        "functionBlocks": [_entry(block) for block in blocks],
        "types": [_type(one) for one in every],
        "globals": [],
        "headers": list(protocol.includes),
        "isBuiltin": False,
    }
    return json.dumps({"formatVersion": 1, "manifest": manifest, "chunks": chunks, "dependencies": []}, indent=1)


def _chunk(
    package: str, name: str, kind: str, header: Iterable[str], cpp: Iterable[str], needs: Iterable[str]
) -> dict[str, object]:
    text, body = ("".join(f"{line}\n" for line in lines) for lines in (header, cpp))
    deps = [{"library": package, "name": needed} for needed in dict.fromkeys(needs)]
    return {"name": name, "kind": kind, "header": text, "cpp": body, "deps": deps}


def _needs(variables: Iterable[Variable], known: set[str]) -> Iterator[str]:
    for variable in variables:
        name = variable.type.rpartition(" ")[2].upper()
        if name in known:
            yield name


def _entry(block: Block) -> dict[str, object]:
    return {
        "name": block.name.upper(),
        "inputs": [_member(variable) for variable in block.inputs],
        "outputs": [_member(variable) for variable in block.outputs],
        "inouts": [],
        "documentation": block.doc,
    }


def _type(one: Structure) -> dict[str, object]:
    return {"name": one.name.upper(), "kind": "struct", "fields": [_member(member) for member in one.members]}


def _member(variable: Variable) -> dict[str, str]:
    return {"name": variable.name.upper(), "type": manifest_type(variable.type)}


def _structure(one: Structure) -> Iterator[str]:
    name = one.name.upper()
    yield f"struct {name} {{"
    for member in one.members:
        yield f"    {cpp_type(member.type)} {member.name.upper()}{{{cpp_value(member)}}};"
    yield "};"
    yield f"using IEC_{name} = {name};"


def _class(block: Block) -> Iterator[str]:
    name = block.name.upper()
    yield f"class {name} {{"
    yield "public:"
    for variable in (*block.inputs, *block.outputs, *block.locals):
        yield f"    {cpp_type(variable.type)} {variable.name.upper()}{{{cpp_value(variable)}}};"
    yield "    IEC_BOOL ENO{true};"
    yield f"    {name}();"
    yield "    void operator()();"
    yield f"    virtual ~{name}() = default;"
    yield "};"


def _body(block: Block) -> Iterator[str]:
    name = block.name.upper()
    yield f"{name}::{name}() {{}}"
    yield f"void {name}::operator()() {{"
    yield from (f"    {line}" for line in block.body)
    yield "}"
