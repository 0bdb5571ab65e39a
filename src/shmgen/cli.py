"""Turns a command line into calls of the pipeline, and its answers into text, files and exit codes."""

from __future__ import annotations

import io
import os
import sys
from collections.abc import Iterable, Mapping
from dataclasses import replace
from pathlib import Path

import click

from shmgen import __version__, drift, live_cli, options, pipeline
from shmgen import config as configuration
from shmgen.config import TARGETS, Config
from shmgen.diagnostics import CODES, Diagnostic, Rejected, Report, Span


def main() -> None:
    """The `shmgen` command. Exit 0 clean, 1 diagnostics, 2 wrong usage."""
    if isinstance(sys.stdout, io.TextIOWrapper):
        # A sign in a comment that the terminal does not know is no reason to stop.
        sys.stdout.reconfigure(errors="replace")
    try:
        cli(standalone_mode=True)
    except Rejected as rejected:
        _complain(rejected.diagnostics)
        sys.exit(1)
    except Exception as error:
        if os.environ.get("SHMGEN_DEBUG"):
            raise
        hint = "this is a fault of shmgen, not of your input: run again with SHMGEN_DEBUG=1 and report what it prints"
        _complain([Diagnostic("SHM901", f"{type(error).__name__}: {error}", Span("shmgen"), hint=hint)])
        sys.exit(1)


@click.group(context_settings={"help_option_names": ["-h", "--help"], "max_content_width": 100})
@click.version_option(__version__, "-V", "--version")
def cli() -> None:
    """Shared-memory bridge code between a CODESYS softPLC and ROS, from ROS message definitions.

    \b
    shmgen list                          what there is
    shmgen show geometry_msgs/Pose       where its bytes go
    shmgen generate geometry_msgs/Pose   Python, Structured Text and C that agree on them
    shmgen doctor                        how the regions fare that are live now
    """  # noqa: D301 click's own sign


@cli.command()
@click.argument("messages", nargs=-1, metavar="[TYPE|PACKAGE|FILE]...")
@click.option(
    "-o",
    "--output",
    type=click.Path(path_type=Path, file_okay=False),
    default=Path("generated"),
    show_default=True,
    help="Folder for the files.",
)
@click.option(
    "-t",
    "--target",
    multiple=True,
    type=click.Choice(TARGETS),
    help="Only this target, and the others' files removed; may be repeated.",
)
@click.option("-q", "--quiet", is_flag=True, help="Print nothing but diagnostics.")
@options.where
def generate(
    messages: tuple[str, ...],
    output: Path,
    target: tuple[str, ...],
    quiet: bool,
    config_file: Path | None,
    include: tuple[Path, ...],
) -> None:
    """Write the bindings of messages: geometry_msgs/Pose, geometry_msgs (all of it), path/to/Foo.msg.

    With names, they join what the output folder already holds; without, the folder becomes what shmgen.toml
    lists. Files are replaced whole, only where they differ; after an error none is touched.
    """
    from shmgen.write import write

    config = options.load(config_file, include)
    if target:
        config = replace(config, targets=target)
    lock, formerly = _lock(output)
    if messages:
        requests = [*messages, *lock.requested]
    else:
        requests, formerly = [*config.messages, *(topic.type for topic in config.topics)], {}
    texts = _generated(config, requests, formerly, output)
    leftovers = sorted(set(lock.files or ()) - set(texts))
    written = write(output, texts, leftovers, last=drift.LOCK)
    if not quiet:
        removed = f", {len(written.removed)} removed" if written.removed else ""
        click.echo(f"{output}: {len(written.changed)} files written, {len(written.unchanged)} unchanged{removed}")
        for path in written.changed:
            click.echo(f"  {output / path}")


@cli.command()
@click.argument("type_name", metavar="TYPE")
@click.option("--json", "as_json", is_flag=True, help="For machines.")
@click.option("--svg", "as_svg", is_flag=True, help="A drawing of the memory map.")
@options.where
def show(type_name: str, as_json: bool, as_svg: bool, config_file: Path | None, include: tuple[Path, ...]) -> None:
    """Where the bytes of a message go: offset, size, ROS type, IEC type, comment."""
    from shmgen import show

    if as_json and as_svg:
        raise click.UsageError("--json or --svg, not both.")
    layouts = pipeline.lay_out(options.load(config_file, include), [type_name])
    shown = [layout for layout in layouts.values() if layout.requested]
    if as_json:
        click.echo(show.as_json(shown, layouts), nl=False)
    elif as_svg:
        from shmgen import memory_map
        from shmgen.render import render

        if len(shown) > 1:
            raise click.UsageError(f"--svg draws one message: {', '.join(str(layout.name) for layout in shown)}")
        for drawing in render([memory_map.plan(shown[0], layouts)]).values():
            click.echo(drawing.encode(), nl=False)
    else:
        click.echo("\n".join(show.table(layout, layouts) for layout in shown), nl=False)


@cli.command()
@options.where
def types(config_file: Path | None, include: tuple[Path, ...]) -> None:
    """The table of types in force, between ROS, IEC 61131-3 and C."""
    from shmgen import show

    click.echo(show.type_table(options.load(config_file, include).types), nl=False)


@cli.command("list")
@click.argument("package", required=False)
@click.option("--json", "as_json", is_flag=True, help="For machines.")
@options.where
def list_(package: str | None, as_json: bool, config_file: Path | None, include: tuple[Path, ...]) -> None:
    """What can be generated, with its size, and the fields that still need a bound."""
    from shmgen import show

    click.echo(show.inventory(pipeline.inventory(options.load(config_file, include), package), as_json), nl=False)


@cli.command()
@click.argument("code", type=click.Choice(list(CODES), case_sensitive=False))
def explain(code: str) -> None:
    """What a diagnostic means and how to mend it."""
    installed = Path(__file__).parent / "diagnostics.md"
    document = installed if installed.is_file() else Path(__file__).parents[2] / "docs" / "diagnostics.md"
    text = document.read_text(encoding="utf-8")
    section = text.partition(f"## {code}")[2].partition("\n## ")[0]
    click.echo(f"{code}{section.rstrip()}")


for live in live_cli.COMMANDS:
    cli.add_command(live)


def _generated(config: Config, requests: list[str], formerly: Mapping[str, Span], output: Path) -> dict[str, str]:
    """{path: text} of all targets. What is wrong with a request is told at the place where it was written."""
    if not requests:
        hint = 'name one, `shmgen generate geometry_msgs/Pose`, or list them in shmgen.toml: messages = ["..."]'
        raise Rejected([Diagnostic("SHM504", "no messages to generate", Span("command line"), hint=hint)])
    try:
        return pipeline.generate(config, dict.fromkeys(requests))
    except Rejected as rejected:
        raise Rejected(_placed(found, config.places, formerly, output) for found in rejected.diagnostics) from rejected


def _placed(found: Diagnostic, written: Mapping[str, Span], formerly: Mapping[str, Span], output: Path) -> Diagnostic:
    request = found.span.path
    if request in written:
        return replace(found, span=written[request])
    if request in formerly:
        hint = f"a former run was asked for it: say again where it is, or delete {output}/ to start afresh"
        return replace(found, span=formerly[request], hint=f"{found.hint}\n{hint}")
    return found


def _lock(output: Path) -> tuple[drift.Lock, dict[str, Span]]:
    """What a former run left in the folder, and where each of its requests stands there. Raises Rejected: SHM401."""
    file = output / drift.LOCK
    if not file.is_file():
        return drift.Lock(), {}
    report = Report()
    text = file.read_text(encoding="utf-8", errors="replace")
    lock = drift.read(text, str(file), report)
    report.stop_if_any()
    return lock, configuration.quoted(text, str(file), lock.requested)


def _complain(diagnostics: Iterable[Diagnostic]) -> None:
    for diagnostic in diagnostics:
        first, _, rest = str(diagnostic).partition("\n")
        where, mark, message = first.partition(": error[")
        click.echo(click.style(where, bold=True) + click.style(mark + message, fg="red"), err=True)
        if rest:
            click.echo(rest, err=True)
