"""The commands that look at topics as `ros2 topic` does."""

from __future__ import annotations

import json
import shutil
import sys
from collections.abc import Callable
from dataclasses import asdict
from itertools import islice
from typing import Any

import click

from shmgen.cli import common, options

_window = click.option(
    "-w",
    "--window",
    type=click.IntRange(2),
    default=10_000,
    show_default=True,
    help="Number of newest samples in each report.",
)


@click.command()
@common.json_option
@common.report_errors
def topics(as_json: bool) -> None:
    """List topics in shared memory, with type, writer and readers."""
    from shmgen.live import processes
    from shmgen.live.regions import unlisted
    from shmgen.tools.messages.format import as_line
    from shmgen.tools.watch import overview as tool

    rows = tool.look(processes=processes.look())
    if as_json:
        click.echo(as_line([region.plain(tool.DETAILS) for region in rows]))
    elif rows:
        width = shutil.get_terminal_size().columns if sys.stdout.isatty() else None
        click.echo("\n".join(tool.table(rows, width=width, columns=tool.LISTED)))
    if hidden_reason := unlisted(rows):
        common.note(hidden_reason)


@click.command()
@common.topic
@common.json_option
@common.report_errors
def info(topic: str, as_json: bool) -> None:
    """Print type, size, sample count, writer and readers of a topic."""
    from shmgen.tools.messages.format import as_line
    from shmgen.tools.watch import overview as tool

    row, hidden = tool.one(topic)
    click.echo(as_line(row.plain(tool.DETAILS)) if as_json else tool.text(row, hidden))


def _report(name: str, measure: str, summary: str, add_options: Callable[[Any], Any]) -> click.Command:
    """Return a command that prints the rate, bandwidth or delay of a topic once a second.

    `name` is the name of the command, and `measure` the name of a function in tools.watch.reports. `add_options` is a
    decorator that adds more options to the command, or returns the command unchanged.
    """

    @click.command(name, help=f"{summary}\n\nThe command prints one report per second.")
    @common.topic
    @_window
    @common.count("reports")
    @common.timeout
    @common.json_option
    @add_options
    @common.report_errors
    def command(
        topic: str,
        window: int,
        count: int | None,
        timeout: float | None,
        as_json: bool,
        source: options.Source | None = None,
    ) -> None:
        from shmgen.tools.watch import reports as tool

        registry = common.registry(source) if source else None
        reports = tool.reports(getattr(tool, measure), topic, registry, window, timeout, common.note)
        try:
            for report in islice(reports, count):
                click.echo(json.dumps(asdict(report)) if as_json else str(report))
        finally:
            reports.close()

    return command


_AGE = "The age is the time since header.stamp, or since the writer's time stamp if the message has no header."
hz = _report("hz", "rate", "Print the rate of a topic, and the time between samples.", lambda command: command)
bw = _report("bw", "bandwidth", "Print the bandwidth of a topic.", lambda command: command)
delay = _report("delay", "delay", f"Print the age of samples on arrival.\n\n{_AGE}", options.source_options)


_SHELLS = {
    "bash": "echo 'eval \"$(shmgen completion bash)\"' >> ~/.bashrc",
    "zsh": "echo 'eval \"$(shmgen completion zsh)\"' >> ~/.zshrc",
    "fish": "shmgen completion fish > ~/.config/fish/completions/shmgen.fish",
}


@click.command(epilog="\b\nTo enable completion:\n" + "\n".join(f"  {line}" for line in _SHELLS.values()))
@click.argument("shell", type=options.Word(list(_SHELLS)))
def completion(shell: str) -> None:
    """Print the completion script of a shell.

    The script completes commands, options, topics, types and fields.
    """
    from click.shell_completion import get_completion_class

    from shmgen.cli.main import cli

    kind = get_completion_class(shell)
    assert kind is not None
    click.echo(kind(cli, {}, "shmgen", "_SHMGEN_COMPLETE").source())


COMMANDS = (topics, info, hz, bw, delay, completion)
