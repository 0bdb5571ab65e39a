"""Turns the commands for live regions into calls of the tools, and their answers into text and exit codes."""

from __future__ import annotations

import functools
import json
import os
import signal
import sys
import time
from collections.abc import Callable
from itertools import islice
from pathlib import Path
from typing import TYPE_CHECKING, Any, NoReturn, TypeVar

import click

from shmgen.cli import options

if TYPE_CHECKING:
    from shmgen.live.classes import Workshop

F = TypeVar("F", bound=Callable[..., Any])


def _polite(command: F) -> F:
    """Ctrl-C ends a command as `ros2 topic` does, exit 0; an error is a sentence, exit 1.

    `kill` ends it in order too, exit 143, so that no lock is left taken.
    """

    @functools.wraps(command)
    def run(*arguments: Any, **keywords: Any) -> Any:
        from shmgen.runtime import ShmError

        former = signal.signal(signal.SIGTERM, lambda *_: sys.exit(128 + signal.SIGTERM))
        try:
            return command(*arguments, **keywords)
        except KeyboardInterrupt:
            signal.signal(signal.SIGINT, signal.SIG_IGN)  # who presses twice wants no other end
            sys.exit(0)
        except BrokenPipeError:
            raise
        except (ShmError, ValueError, OSError) as error:
            _fail(str(error))
        finally:
            signal.signal(signal.SIGTERM, former)

    return run  # type: ignore[return-value]


def _topics(context: click.Context, parameter: click.Parameter, incomplete: str) -> list[str]:
    """For the shell's completion."""
    from shmgen.live import regions

    topics = [regions.topic_of(name) for name in regions.live()]
    return [topic for topic in topics if topic.startswith("/" + incomplete.removeprefix("/"))]


def _services(context: click.Context, parameter: click.Parameter, incomplete: str) -> list[str]:
    return [topic.removesuffix("-request") for topic in _topics(context, parameter, incomplete) if "-request" in topic]


_topic = click.argument("topic", shell_complete=_topics)
_json = click.option("--json", "as_json", is_flag=True, help="For machines.")
_count = click.option("-n", "--count", type=click.IntRange(1), help="Stop after so many.")
_timeout = click.option(
    "--timeout", type=click.FloatRange(0), help="Give up, exit 1, after so many seconds without a sample."
)


@click.command()
@click.argument("topic", required=False, shell_complete=_topics)
@_json
@options.where
@_polite
def doctor(topic: str | None, as_json: bool, config_file: Path | None, include: tuple[Path, ...]) -> None:
    """What is wrong with the regions in /dev/shm, or with one, and what to do about it.

    Looks at owner and mode, writer, lock, semaphore, layout and depth (against shmgen.toml and
    generated/layout.lock of this folder), the bitness of the processes that map a region, and at processes
    that hold on to a removed one. Exit 1 if there is a fault; notes are none.
    """
    from shmgen.tools import doctor as tool
    from shmgen.tools import shown

    report = tool.examine(topic, _workshop(config_file, include))
    click.echo(shown.as_line(tool.plain(report), indent=2) if as_json else tool.text(report))
    sys.exit(0 if report.healthy else 1)


@click.command()
@click.argument("topics", nargs=-1, metavar="[TOPIC]...", shell_complete=_topics)
@click.option("--all", "everything", is_flag=True, help="Every region there is, and semaphores half made.")
@click.option("--force", is_flag=True, help="Also what is in use: the processes then hold on to what nobody else sees.")
@click.option("--dry-run", is_flag=True, help="Only say what would be removed.")
@_polite
def clean(topics: tuple[str, ...], everything: bool, force: bool, dry_run: bool) -> None:
    """Remove regions and their semaphores from /dev/shm.

    With --all also what a process left that was killed while it made a semaphore. Not while a writer lives or
    a process has the region open. Exit 1 if one had to stay.
    """
    from shmgen.live import processes, regions
    from shmgen.runtime import ShmError
    from shmgen.tools import clean as tool
    from shmgen.tools import unfinished

    if everything == bool(topics):
        raise click.UsageError("Name topics, or --all; `shmgen doctor` lists what there is.")
    around = processes.look()

    def leftovers(topic: str) -> list[str]:
        files = tool.leftovers(topic)
        if not force and (why := tool.in_use(topic, around)):
            hint = f"stop it first; `shmgen clean --force {topic}` removes the files under its feet"
            raise ShmError(f"{topic}: {why}\n  hint: {hint}")
        return files

    chosen = (
        [regions.topic_of(name) for name in regions.live()]
        if everything
        else [half for topic in topics for half in regions.meant(topic)]
    )
    finds = [functools.partial(leftovers, topic) for topic in chosen]
    if everything:
        finds.append(functools.partial(unfinished.semaphores, around))
    stays = False
    for find in finds:
        try:
            files = find()
            if not dry_run:
                tool.remove(files)
        except ShmError as error:
            _complain(str(error))
            stays = True
        else:
            for file in files:
                click.echo(f"{'would remove' if dry_run else 'removed'} {file}")
    sys.exit(1 if stays else 0)


@click.command()
@_topic
@click.option("--once", is_flag=True, help="One sample, the newest if there is one already.")
@_count
@_timeout
@_json
@click.option("-f", "--full", is_flag=True, help="Arrays whole, not only their first 32 elements.")
@options.where
@_polite
def echo(
    topic: str,
    once: bool,
    count: int | None,
    timeout: float | None,
    as_json: bool,
    full: bool,
    config_file: Path | None,
    include: tuple[Path, ...],
) -> None:
    """Print the samples of a topic as they come: YAML, or one line of JSON each.

    The region's header names the type, so nothing needs to be generated. Own messages are found with -I or by
    shmgen.toml, bounds there or in generated/layout.lock. Waits for a region that does not exist yet. A sample
    whose counts are above their bounds is told instead of printed; exit 1 if there was one.
    """
    from shmgen.runtime import CountExceeded
    from shmgen.tools import follow, shown

    samples = follow.samples(topic, _workshop(config_file, include), timeout, _note)
    refused = False
    try:
        for message in islice(samples, 1 if once else count):
            try:
                text = shown.as_json(message) if as_json else shown.yaml(message, None if full else shown.SHORT)
            except CountExceeded as error:
                _complain(f"{topic}: damaged sample: {error}")
                refused = True
            else:
                click.echo(text if as_json else f"{text}---")
    finally:
        samples.close()
    sys.exit(int(refused))


@click.command(context_settings={"ignore_unknown_options": True})
@_topic
@click.argument("type_name", metavar="TYPE")
@click.argument("values", default="{}", metavar="[VALUES]")
@click.option("-r", "--rate", type=click.FloatRange(0.001, 10000), default=1.0, show_default=True, help="In Hz.")
@click.option("--once", is_flag=True, help="One sample, which stays in the region.")
@_count
@options.where
@_polite
def pub(
    topic: str,
    type_name: str,
    values: str,
    rate: float,
    once: bool,
    count: int | None,
    config_file: Path | None,
    include: tuple[Path, ...],
) -> None:
    """Publish VALUES, YAML or JSON, on a topic; fields left out get their default, a time may be `now`.

    \b
    shmgen pub /robot/pose geometry_msgs/Pose '{position: {x: 1.0}}' -r 10
    """  # noqa: D301 click's own sign
    from shmgen.tools import given
    from shmgen.tools import pub as tool

    data = given.parse(values)
    samples = tool.publish(topic, type_name, data, _workshop(config_file, include), rate, 1 if once else count)
    for number, message in enumerate(samples, start=1):
        click.echo(f"publishing #{number}: {message}")


@click.command(context_settings={"ignore_unknown_options": True})
@click.argument("service", shell_complete=_services)
@click.argument("type_name", metavar="TYPE")
@click.argument("values", default="{}", metavar="[VALUES]")
@click.option("--timeout", type=click.FloatRange(0), default=5.0, show_default=True, help="In seconds, all in all.")
@_json
@options.where
@_polite
def call(
    service: str,
    type_name: str,
    values: str,
    timeout: float,
    as_json: bool,
    config_file: Path | None,
    include: tuple[Path, ...],
) -> None:
    """Call a service with VALUES, YAML or JSON, and print its response.

    \b
    shmgen call /cell/start std_srvs/SetBool '{data: true}'

    Waits for a server that is not there yet. One client a service: not while the PLC or a bridge has it open.
    """  # noqa: D301 click's own sign
    from shmgen.tools import call as tool
    from shmgen.tools import given, shown

    request, kind = tool.build(service, type_name, given.parse(values), _workshop(config_file, include))
    with kind(service) as client:
        if not as_json:
            click.echo(f"requesting: {request}")
        response = client.call(request, timeout)
        click.echo(shown.as_json(response) if as_json else shown.yaml(response, None), nl=as_json)


@click.command()
@_topic
@click.option("-w", "--window", type=click.IntRange(2), default=10_000, show_default=True, help="In samples.")
@_count
@_timeout
@_json
@_polite
def hz(topic: str, window: int, count: int | None, timeout: float | None, as_json: bool) -> None:
    """The rate of a topic, and the shortest, longest and usual time between two samples, once a second."""
    from shmgen.tools import hz as tool

    rates = tool.rates(topic, window, timeout, _note)
    try:
        for rate in islice(rates, count):
            click.echo(json.dumps(rate.plain()) if as_json else str(rate))
    finally:
        rates.close()


@click.command()
@click.option(
    "-d", "--delay", type=click.FloatRange(0.1), default=1.0, show_default=True, help="Seconds between tables."
)
@click.option("--once", is_flag=True, help="One table.")
@_count
@_json
@_polite
def top(delay: float, once: bool, count: int | None, as_json: bool) -> None:
    """All regions in a live table: type, writer, rate, age of the newest sample, use of the lock.

    Keys: q quits, s sorts by the next column, r reverses. In a pipe it prints one table after the other.
    """
    from shmgen.tools import screen
    from shmgen.tools import top as tool
    from shmgen.tools.shown import as_line

    number = 1 if once else count
    if screen.can_draw() and number is None and not as_json:
        screen.run(delay)
        return
    past: tool.Past = {}
    widths: dict[str, int] = {}
    tool.look(past)
    shown = 0
    while shown != number:
        time.sleep(delay)
        rows = tool.ordered(tool.look(past), "topic", reverse=False)
        shown += 1
        if as_json:
            click.echo(as_line([row.plain() for row in rows]))
        else:
            click.echo("\n".join([*tool.table(rows, widths_before=widths), *([] if shown == number else [""])]))


COMMANDS = (doctor, clean, echo, pub, call, hz, top)


def _workshop(file: Path | None, include: tuple[Path, ...]) -> Workshop:
    from shmgen.live.classes import Workshop
    from shmgen.live.locked import LOCK
    from shmgen.live.session import Session

    config = options.load(file, include)
    found = options.file_in_force(file)
    lock = Path(os.path.relpath(config.root / LOCK))
    name = found.name if found else "the defaults, as there is no shmgen.toml here"
    return Workshop(Session(config, name), lock)


def _note(text: str) -> None:
    from shmgen.runtime.legible import lines

    click.echo(click.style(lines(text), fg="yellow"), err=True)


def _complain(text: str) -> None:
    from shmgen.runtime.legible import lines

    first, _, rest = lines(text).partition("\n")
    click.echo(click.style("error: ", fg="red", bold=True) + first, err=True)
    if rest:
        click.echo(rest, err=True)


def _fail(text: str) -> NoReturn:
    _complain(text)
    sys.exit(1)
