"""Turns a command line into calls of the pipeline, and its answers into text, files and exit codes."""

from __future__ import annotations

import io
import os
import sys
from dataclasses import replace
from pathlib import Path

import click

from shmgen import __version__, asked, bridge_cli, drift, drift_cli, live_cli, options, pipeline
from shmgen.config import EXTRA_TARGETS, TARGETS
from shmgen.diagnostics import CODES, Diagnostic, Rejected, Span


def main() -> None:
    """The `shmgen` command. Exit 0 clean, 1 diagnostics, 2 wrong usage."""
    if isinstance(sys.stdout, io.TextIOWrapper):
        # A sign in a comment that the terminal does not know is no reason to stop.
        sys.stdout.reconfigure(errors="replace")
    try:
        cli(standalone_mode=True)
    except Rejected as rejected:
        options.complain(rejected.diagnostics)
        sys.exit(1)
    except Exception as error:
        if os.environ.get("SHMGEN_DEBUG"):
            raise
        hint = "this is a fault of shmgen, not of your input: run again with SHMGEN_DEBUG=1 and report what it prints"
        options.complain([Diagnostic("SHM901", f"{type(error).__name__}: {error}", Span("shmgen"), hint=hint)])
        sys.exit(1)


@click.group(context_settings={"help_option_names": ["-h", "--help"], "max_content_width": 100})
@click.version_option(__version__, "-V", "--version")
def cli() -> None:
    """Shared-memory bridge code between a CODESYS softPLC and ROS, from ROS message definitions.

    \b
    shmgen list                          what there is
    shmgen show geometry_msgs/Pose       where its bytes go
    shmgen generate geometry_msgs/Pose   Python, Structured Text and C that agree on them
    shmgen bridge                        topics of ROS to regions and back
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
    type=click.Choice((*TARGETS, *EXTRA_TARGETS)),
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
    lock, formerly = asked.former(output)
    if messages:
        requests = [*messages, *lock.requested]
    else:
        requests, formerly = asked.configured(config), {}
    texts = asked.texts(config, requests, formerly, output)
    leftovers = sorted(set(lock.files) - set(texts))
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


for command in (*drift_cli.COMMANDS, *bridge_cli.COMMANDS, *live_cli.COMMANDS):
    cli.add_command(command)
