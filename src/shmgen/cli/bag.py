"""The commands record and play."""

from __future__ import annotations

import signal
import sys
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING

import click

from shmgen.cli import common, options
from shmgen.core.diagnostics import Diagnostic, Rejected, Span
from shmgen.core.plural import counted

if TYPE_CHECKING:
    from shmgen.bag.record import Figures

_UNITS = {"": 1, "K": 1 << 10, "M": 1 << 20, "G": 1 << 30}


def _size(context: click.Context, parameter: click.Parameter, value: str | None) -> int | None:
    """Convert a size such as `500M` to bytes."""
    if value is None:
        return None
    number, unit = value.rstrip("KMGkmg"), value[len(value.rstrip("KMGkmg")) :].upper()
    if not number.isdecimal() or unit not in _UNITS or not int(number):
        raise click.BadParameter(f"{value!r} is not a size; write it as 500M or 2G", context, parameter)
    return int(number) * _UNITS[unit]


@click.command()
@click.argument("topics", nargs=-1, metavar="[TOPIC]...", shell_complete=common.topics)
@click.option("-a", "--all", "everything", is_flag=True, help="Record all topics, including topics created later.")
@click.option(
    "-o",
    "--output",
    type=click.Path(path_type=Path),
    help="Folder to create for the bag.  [default: named by date and time]",
)
@click.option("--max-size", metavar="SIZE", callback=_size, help="Start a new file at this size, such as 500M or 2G.")
@click.option("--max-duration", type=click.FloatRange(0.1), metavar="SECONDS", help="Start a new file after this time.")
@click.option("-d", "--duration", type=click.FloatRange(0.1), metavar="SECONDS", help="Stop after this time.")
@click.option("-q", "--quiet", is_flag=True, help="Print no progress.")
@options.source_options
@common.report_errors
def record(
    topics: tuple[str, ...],
    everything: bool,
    output: Path | None,
    max_size: int | None,
    max_duration: float | None,
    duration: float | None,
    quiet: bool,
    source: options.Source,
) -> None:
    """Record topics in shared memory into a ROS 2 bag (MCAP).

    The recorder runs until Ctrl-C or SIGTERM. `ros2 bag`, Foxglove, PlotJuggler and `shmgen play` can read the bag. The
    recorder does not write to the shared memory and holds no lock. If a topic does not exist yet, the recorder waits.
    The requests and responses of services and actions are recorded as topics. The bag stays readable after SIGKILL or
    on a full disk. The exit code is 1 if a topic could not be recorded.
    """
    from shmgen.bag.folder import Bag
    from shmgen.bag.record import Recorder
    from shmgen.live import regions

    if everything == bool(topics):
        raise click.UsageError("Give topics or --all; `shmgen topics` lists the existing topics.")
    folder = output or Path(time.strftime("shmgen_%Y_%m_%d-%H_%M_%S"))
    registry = common.registry(source)
    chosen = None if everything else topics
    stopping = threading.Event()
    try:
        bag = Bag(folder, max_size, max_duration)
    except FileExistsError:
        hint = "name a new folder with -o"
        raise Rejected([Diagnostic("SHM007", "the folder exists already", Span(str(folder)), hint=hint)]) from None
    recorder = Recorder(registry, bag, chosen, common.note)
    with _ended_by_signals(stopping), _progress(lambda: _line(recorder.figures), quiet):
        try:
            recorder.run(stopping, duration)
        except OSError as error:
            rest = f"{counted(bag.samples, 'sample')} were stored before and can be read"
            message = f"cannot write: {error.strerror or error}; {rest}"
            hint = "free space on the disk, and record into another folder"
            raise Rejected([Diagnostic("SHM007", message, Span(str(folder)), hint=hint)]) from error
    figures = recorder.figures
    click.echo(f"{folder}: {counted(len(bag.files), 'file')}, {_line(figures)}")
    unseen = recorder.never_seen(topics)
    for topic in unseen:
        options.print_diagnostics([common.diagnostic(regions.missing(topic))])
    sys.exit(int(recorder.failed or figures.damaged > 0 or bool(unseen)))


@click.command()
@click.argument("path", metavar="BAG", type=click.Path(path_type=Path))
@click.option(
    "-r",
    "--rate",
    type=click.FloatRange(0.001, 1000),
    default=1.0,
    show_default=True,
    help="Speed; 2 plays twice as fast.",
)
@click.option("-l", "--loop", is_flag=True, help="Repeat until Ctrl-C.")
@click.option(
    "--start", type=click.FloatRange(0), default=0.0, metavar="SECONDS", help="Skip this many seconds of the recording."
)
@click.option("--topics", "chosen", multiple=True, metavar="TOPIC", help="Play only this topic; may be repeated.")
@click.option("-q", "--quiet", is_flag=True, help="Print no progress.")
@options.source_options
@common.report_errors
def play(
    path: Path, rate: float, loop: bool, start: float, chosen: tuple[str, ...], quiet: bool, source: options.Source
) -> None:
    """Publish the samples of a bag at the recorded intervals.

    BAG is a folder or an .mcap file from `shmgen record` or `ros2 bag`; a damaged file is played up to the damage. In a
    test, a bag replaces the robot or the PLC. Stop the replaced publisher first, because a topic has one publisher. The
    command plays services and actions only if --topics names them. The command rejects a bag if its message layouts
    differ from your shmgen.toml.
    """
    from shmgen.bag.play import Player

    words = [topic for topics in chosen for topic in topics.replace(",", " ").split()]
    player = Player(path, common.registry(source), words or None, common.note)
    length, at = (player.last - player.first) / 1e9, [0.0]
    try:
        with _progress(lambda: f"{at[0]:.1f} of {length:.1f} s, {counted(player.played, 'sample')}", quiet):
            while True:
                for at[0] in player.play(rate, start):
                    pass
                if not loop or not player.played:
                    break
    finally:
        refused = f", {player.refused:,} refused" if player.refused else ""
        click.echo(f"{path}: {counted(player.played, 'sample')} on {counted(len(player.topics), 'topic')}{refused}")
        player.close()
    sys.exit(int(player.refused > 0))


def _line(figures: Figures) -> str:
    damaged = f", {figures.damaged:,} damaged" if figures.damaged else ""
    samples, topics = counted(figures.samples, "sample"), counted(figures.topics, "topic")
    return f"{samples} of {topics}, {figures.missed:,} missed{damaged}, {figures.size / 1e6:.1f} MB"


@contextmanager
def _ended_by_signals(stopping: threading.Event) -> Iterator[None]:
    """Set `stopping` if SIGINT or SIGTERM arrives while the `with` block runs.

    The block can then complete the last sample and the bag's index.
    """
    before = {number: signal.signal(number, lambda *_: stopping.set()) for number in (signal.SIGINT, signal.SIGTERM)}
    try:
        yield
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)


@contextmanager
def _progress(line: Callable[[], str], quiet: bool) -> Iterator[None]:
    """Show a progress line each second while the `with` block runs, if stderr is a terminal.

    `line` returns the text. A thread writes the line, because a terminal may block.
    """
    over = threading.Event()

    def show() -> None:
        begun = time.monotonic()
        while not over.wait(1):
            text = f"{time.monotonic() - begun:.0f} s: {line()}"
            sys.stderr.write(f"\r{common.fitting(text)}\x1b[K")
            sys.stderr.flush()

    if quiet or not common.can_overwrite(sys.stderr):
        yield
        return
    thread = threading.Thread(target=show, daemon=True)
    thread.start()
    try:
        yield
    finally:
        over.set()
        thread.join(1)
        sys.stderr.write("\r\x1b[K")


COMMANDS = (record, play)
