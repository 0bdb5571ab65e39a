"""The commands that look at topics as `ros2 topic` does."""

from __future__ import annotations

import shutil
import sys
from pathlib import Path

import click

from shmgen.cli import common, options
from shmgen.core.plural import counted

_window = click.option(
    "-w", "--window", type=click.IntRange(2), default=10_000, show_default=True, help="Window size, in samples."
)


@click.command()
@common.for_machines
@common.polite
def topics(as_json: bool) -> None:
    """List live regions: type, writer, readers, depth, age of the newest sample."""
    from shmgen.live.regions import unlisted
    from shmgen.tools.messages.format import as_line
    from shmgen.tools.watch import topics as tool

    found = tool.look()
    if as_json:
        click.echo(as_line([region.plain() for region in found]))
    elif found:
        width = shutil.get_terminal_size().columns if sys.stdout.isatty() else None
        click.echo("\n".join(tool.table(found, width)))
    if said := unlisted(found):
        common.note(said)


@click.command()
@common.topic
@common.for_machines
@common.polite
def info(topic: str, as_json: bool) -> None:
    """Print details of a topic: type, digest, file, payload, samples, writer, readers."""
    from shmgen.tools.messages.format import as_line
    from shmgen.tools.watch import topics as tool

    found, hidden = tool.one(topic)
    click.echo(as_line(found.plain()) if as_json else tool.text(found, hidden))


@click.command()
@common.topic
@_window
@common.count
@common.timeout
@common.for_machines
@common.polite
def bw(topic: str, window: int, count: int | None, timeout: float | None, as_json: bool) -> None:
    """Print the bandwidth of a topic, once a second."""
    from shmgen.tools.watch import reports as tool

    common.show(tool.reports(tool.bandwidth, topic, None, window, timeout, common.note), count, as_json)


@click.command()
@common.topic
@_window
@common.count
@common.timeout
@common.for_machines
@options.where
@common.polite
def delay(
    topic: str,
    window: int,
    count: int | None,
    timeout: float | None,
    as_json: bool,
    config_file: Path | None,
    include: tuple[Path, ...],
) -> None:
    """Print the age of samples on arrival, once a second.

    By header.stamp, or the writer's own time stamp where the message has none.
    """
    from shmgen.tools.watch import reports as tool

    registry = common.registry(config_file, include)
    common.show(tool.reports(tool.delay, topic, registry, window, timeout, common.note), count, as_json)


@click.command()
@common.topic
@click.argument("paths", nargs=-1, required=True, metavar="FIELD...", shell_complete=common.numbers)
@click.option("-s", "--seconds", type=click.FloatRange(0.1), default=10.0, show_default=True, help="Time span to show.")
@click.option("--once", is_flag=True, help="Draw once, after that time span; the default in a pipe.")
@options.where
@common.polite
def plot(
    topic: str,
    paths: tuple[str, ...],
    seconds: float,
    once: bool,
    config_file: Path | None,
    include: tuple[Path, ...],
) -> None:
    """Plot numeric fields of a topic in the terminal.

    \b
    shmgen plot /arm/pose position.x position.y
    """  # noqa: D301 click's own sign
    from shmgen.tools.watch import plot as tool

    curves = tool.Plot(topic, paths, seconds, common.registry(config_file, include), common.note)
    plain = not common.shows_unicode(sys.stdout)

    def drawn() -> list[str]:
        size = shutil.get_terminal_size()
        return tool.drawing(curves.points, size.columns, min(24, size.lines - 1), plain=plain)

    try:
        if once or not common.can_overwrite(sys.stdout):
            curves.watch(seconds)
            click.echo("\n".join(drawn()))
            return
        lines: list[str] = []
        while curves.watch(0.1):
            back = f"\x1b[{len(lines)}A\r" if lines else ""
            lines = drawn()
            click.echo(f"{back}" + "\n".join(f"{line}\x1b[K" for line in lines) + "\x1b[J")
        common.note(f"{topic}: the region was removed")
    finally:
        if curves.missed:
            samples = counted(curves.missed, "sample")
            common.note(f"{topic}: {samples} overwritten before they could be read here")
        curves.close()


_SHELLS = {
    "bash": "echo 'eval \"$(shmgen completion bash)\"' >> ~/.bashrc",
    "zsh": "echo 'eval \"$(shmgen completion zsh)\"' >> ~/.zshrc",
    "fish": "shmgen completion fish > ~/.config/fish/completions/shmgen.fish",
}


@click.command(epilog="\b\nTo turn it on:\n" + "\n".join(f"  {line}" for line in _SHELLS.values()))
@click.argument("shell", type=click.Choice(list(_SHELLS)))
def completion(shell: str) -> None:
    """Print the completion script of a shell.

    Completes commands, options, live topics, types and fields.
    """
    from click.shell_completion import get_completion_class

    from shmgen.cli.main import cli

    kind = get_completion_class(shell)
    assert kind is not None
    click.echo(kind(cli, {}, "shmgen", "_SHMGEN_COMPLETE").source())


COMMANDS = (topics, info, bw, delay, plot, completion)
