"""Turns the command that imports data types of a PLC project into files of a message package."""

from __future__ import annotations

import re
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING

import click

from shmgen.cli import options
from shmgen.core.diagnostics import Report, Span
from shmgen.core.escape import legible
from shmgen.core.plural import counted

if TYPE_CHECKING:
    from shmgen.plc.messages import Row


@click.command("import")
@click.argument("files", nargs=-1, required=True, type=click.Path(path_type=Path), metavar="FILE|FOLDER...")
@click.option("-p", "--package", help="Name of the message package.  [default: name of the first file, with _msgs]")
@click.option(
    "-o",
    "--output",
    type=click.Path(path_type=Path, file_okay=False),
    default=Path("msgs"),
    show_default=True,
    help="Folder in which to create the package.",
)
@click.option("--skip", is_flag=True, help="Leave out types that cannot be messages, and write the rest.")
def import_(files: tuple[Path, ...], package: str | None, output: Path, skip: bool) -> None:
    """Create message definitions from the data types (DUTs) of a PLC project.

    Reads PLCopen XML, .TcDUT and .st files. Names, comments and bytes are kept: Structured Text generated from the
    definitions has the imported types again. After an error nothing is written.
    """
    from shmgen.core.write import current, write
    from shmgen.plc import messages, sources

    package = package or _package(files[0])
    if not re.fullmatch(r"[a-z](_?[a-z0-9])+", package):
        raise click.BadParameter(
            f"{package} is not a package name: lower-case letters, digits and single _", param_hint="-p"
        )
    report = Report()
    project = sources.read(files, report)
    if not skip:
        report.stop_if_any()
    made = messages.messages(project, package, report)
    if not made.rows:
        hint = "export the data types (DUTs) too; function blocks and programs hold none"
        report.error("SHM504", "no data types are in it", Span(str(files[0])), hint=hint)
    if not (skip and made.texts):
        report.stop_if_any()
    options.complain(replace(found, level="note") for found in report.diagnostics)
    last = "CMakeLists.txt"
    write(output / package, made.texts, (), last, current(output / package, last))
    width = max(len(row.declared.name) for row in made.rows)
    for row in made.rows:
        click.echo(f"{row.declared.name:<{width}}  {_became(row, package)}")
    usable = sum(bool(row.message) for row in made.rows)
    click.echo(f"\n{usable} of {len(made.rows)} data types are messages in {(output / package).as_posix()}")
    if not all(row.sure for row in made.rows):
        click.echo("not verified: the bytes of an empty structure, and where a base ends in padding; compare SIZEOF")
    click.echo(
        f'use them: path = ["{output.as_posix()}"] in shmgen.toml, and below [types] bool = "BOOL", as they have it'
    )


def _package(file: Path) -> str:
    """`Plant V2.xml` -> `plant_v2_msgs`."""
    stem = re.sub(r"[^a-z0-9]+", "_", file.stem.lower()).strip("_")
    stem = stem if stem[:1].isalpha() else f"plc_{stem}".rstrip("_")
    return stem if stem.endswith("_msgs") else f"{stem}_msgs"


def _became(row: Row, package: str) -> str:
    if not row.message:
        return legible(f"left out: {row.why}")
    return f"{package}/{row.message}, {counted(row.size, 'byte')}{'' if row.sure else ', not verified'}"


COMMANDS = (import_,)
