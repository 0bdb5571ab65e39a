"""The commands for a PLC's project: what is imported from one, and what tests the runtime of one."""

from __future__ import annotations

import re
import sys
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING

import click

from shmgen import __version__
from shmgen.cli import common, options
from shmgen.core import abi
from shmgen.core.diagnostics import Report, Span
from shmgen.core.escape import legible
from shmgen.core.plural import counted
from shmgen.core.write import current
from shmgen.core.write import write as put

if TYPE_CHECKING:
    from shmgen.config import Config
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
    put(output / package, made.texts, (), last, current(output / package, last))
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


@click.command()
@click.argument("folder", type=click.Path(path_type=Path, file_okay=False), default=Path("selftest"))
@click.option("--openplc", is_flag=True, help="For OpenPLC v4 and matiec instead of CODESYS.")
@click.option("--write", is_flag=True, help="Only write the PLC's side, on the machine of the IDE.")
@click.option(
    "--wait", type=click.FloatRange(0), default=600.0, show_default=True, help="Seconds for each step by hand."
)
def selftest(folder: Path, openplc: bool, write: bool, wait: float) -> None:
    """Measure how a PLC's runtime treats regions, and print a report to send.

    Writes the PLC's side, PRG_ShmSelfTest, into FOLDER, then is its other side: docs/verified.md. Exits with 1 if
    something is different from what is expected.
    """
    from shmgen import config
    from shmgen.generator.render import template_folder
    from shmgen.generator.selftest import texts

    settings = config.load(template_folder() / "selftest" / "shmgen.toml", "selftest/shmgen.toml", Report())
    made = texts(settings, openplc)
    last = max(made)
    put(folder, made, (), last, current(folder, last))
    loaded = "matiec/upload.st" if openplc else "plcopen/import_shmgen.py, or import shmgen.xml beside it"
    click.echo(f"PLC: {(folder / loaded).as_posix()}, then start it")
    if write or not options.HAS_REGIONS:
        click.echo("then, on the Linux machine of the runtime: shmgen selftest")
        return
    sys.exit(_other_side(settings, wait))


@common.polite
def _other_side(settings: Config, wait: float) -> int:
    """Prints the report; 1 if something is different."""
    from shmgen.live.session import Session
    from shmgen.tools import selftest as tool

    def tell(said: str) -> None:
        click.echo(f"  {said} ({wait:g} s, or it is left out)", err=True)

    click.echo(f"\nshmgen {__version__}, ABI {abi.ABI}; {tool.head()}\nPLC: (device, version of CODESYS or OpenPLC)")
    partner, worst = tool.Partner(Session(settings), wait, tell), 0
    try:
        for line in tool.report(partner):
            click.echo(str(line).rstrip())
            worst |= line.verdict == tool.DIFFERENT
    finally:
        partner.close()
    return worst


COMMANDS = (import_, selftest)
