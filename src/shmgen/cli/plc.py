"""The commands for PLC projects: import of data types, and the self-test of a PLC's runtime."""

from __future__ import annotations

import re
import sys
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
@options.output_folder("Folder in which to create the package.", "msgs")
@click.option("--skip", is_flag=True, help="Omit types that cannot be messages, and write the others.")
def import_(files: tuple[Path, ...], package: str | None, output: Path, skip: bool) -> None:
    """Create ROS message definitions from data types of a PLC project.

    The command reads PLCopen XML, .TcDUT and .st files. The definitions keep names, comments and layouts. If you
    generate Structured Text from these definitions, it contains the same types. If a TwinCAT project has a .tmc file,
    the command compares the layouts with this file. After an error, the command writes no file.
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
    imported = messages.messages(project, package, report)
    if not imported.rows:
        hint = "export the data types (DUTs) too; function blocks and programs contain no data types"
        report.error("SHM504", "no data types are in it", Span(str(files[0])), hint=hint)
    if not (skip and imported.texts):
        report.stop_if_any()
    options.print_diagnostics([*imported.notes, *(problem._replace(level="note") for problem in report.diagnostics)])
    last = "CMakeLists.txt"
    put(output / package, imported.texts, (), last, current(output / package, last))
    width = max(len(row.declared.name) for row in imported.rows)
    for row in imported.rows:
        click.echo(f"{row.declared.name:<{width}}  {_outcome(row, package)}")
    usable = sum(bool(row.message) for row in imported.rows)
    click.echo(f"\n{usable} of {len(imported.rows)} data types are messages in {(output / package).as_posix()}")
    if not all(row.sure or row.verified_by for row in imported.rows):
        click.echo("not verified: the size of an empty structure; compare SIZEOF in the PLC")
    click.echo(f'to use them, write path = ["{output.as_posix()}"] in shmgen.toml, and bool = "BOOL" under [types]')


def _package(file: Path) -> str:
    """Derive a package name from a file name: `Plant V2.xml` -> `plant_v2_msgs`."""
    stem = re.sub(r"[^a-z0-9]+", "_", file.stem.lower()).strip("_")
    stem = stem if stem[:1].isalpha() else f"plc_{stem}".rstrip("_")
    return stem if stem.endswith("_msgs") else f"{stem}_msgs"


def _outcome(row: Row, package: str) -> str:
    if not row.message:
        return legible(f"left out: {row.why}")
    proof = f", verified by {row.verified_by}" if row.verified_by else "" if row.sure else ", not verified"
    return f"{package}/{row.message}, {counted(row.size, 'byte')}{proof}"


@click.command()
@click.argument("folder", type=click.Path(path_type=Path, file_okay=False), default=Path("selftest"))
@click.option("--openplc", is_flag=True, help="Write files for OpenPLC and Beremiz instead of CODESYS.")
@click.option("--write", is_flag=True, help="Only write the PLC program. Use this option on the machine of the IDE.")
@click.option(
    "--wait", type=click.FloatRange(0), default=600.0, show_default=True, help="Seconds to wait for each manual step."
)
def selftest(folder: Path, openplc: bool, write: bool, wait: float) -> None:
    """Test how a PLC handles shared memory, and print a report.

    The command writes the PLC program PRG_ShmSelfTest into FOLDER. Load this program into the PLC and start the PLC:
    the command then exchanges samples with the program. The page docs/guarantees.md explains the results. The exit
    code is 1 if a result differs from the expected result.
    """
    from shmgen import config
    from shmgen.generator.render import template_folder
    from shmgen.generator.selftest import texts

    settings = config.load(template_folder() / "selftest" / "shmgen.toml", "selftest/shmgen.toml", Report())
    texts_by_path = texts(settings, openplc)
    last = max(texts_by_path)
    put(folder, texts_by_path, (), last, current(folder, last))
    loaded = "matiec/upload.st" if openplc else "plcopen/import_shmgen.py, or import shmgen.xml beside it"
    click.echo(f"PLC: load {(folder / loaded).as_posix()}, then start the PLC")
    if write or not options.HAS_REGIONS:
        click.echo("then, on the Linux machine of the runtime: shmgen selftest")
        return
    sys.exit(_run_linux_side(settings, wait))


@common.report_errors
def _run_linux_side(settings: Config, wait: float) -> int:
    """Test the PLC from Linux for at most `wait` seconds a step, and print a report. Return 1 if a result differs."""
    from shmgen.live.session import Session
    from shmgen.tools import selftest as tool

    def tell(step: str) -> None:
        click.echo(f"  {step} (within {wait:g} s, or this step is skipped)", err=True)

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
