"""What the commands for live regions share: how each of them ends, its usual options, what it says on stderr."""

from __future__ import annotations

import functools
import json
import os
import shutil
import signal
import sys
from collections.abc import Callable, Generator, Mapping
from itertools import islice
from pathlib import Path
from typing import TYPE_CHECKING, Any, NoReturn, Protocol, TextIO, TypeVar

import click

from shmgen.cli import options

if TYPE_CHECKING:
    from shmgen.config import Config
    from shmgen.live.classes import ClassRegistry

F = TypeVar("F", bound=Callable[..., Any])


def polite(command: F) -> F:
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
            fail(str(error))
        finally:
            signal.signal(signal.SIGTERM, former)

    return run  # type: ignore[return-value]


def topics(context: click.Context, parameter: click.Parameter, incomplete: str) -> list[str]:
    """For the shell's completion."""
    from shmgen.live import regions

    topics = [regions.topic_of(name) for name in regions.live()]
    return [topic for topic in topics if topic.startswith("/" + incomplete.removeprefix("/"))]


def services(context: click.Context, parameter: click.Parameter, incomplete: str) -> list[str]:
    return [topic.removesuffix("-request") for topic in topics(context, parameter, incomplete) if "-request" in topic]


def types(context: click.Context, parameter: click.Parameter, incomplete: str) -> list[str]:
    """All that can be named, packages first: `geometry_msgs/` and then what is in it."""
    from shmgen.generator import pipeline

    names = [name.short for name in pipeline.library(_load(context)).known()]
    found = [name for name in names if name.startswith(incomplete)]
    return found if "/" in incomplete else sorted({name.partition("/")[0] + "/" for name in found})


def fields(context: click.Context, parameter: click.Parameter, incomplete: str) -> list[str]:
    """Of the topic that stands before it on the line."""
    return _fields(context, parameter, incomplete, numbers=False)


def numbers(context: click.Context, parameter: click.Parameter, incomplete: str) -> list[str]:
    """Those that can be plotted."""
    return _fields(context, parameter, incomplete, numbers=True)


def _fields(context: click.Context, parameter: click.Parameter, incomplete: str, *, numbers: bool) -> list[str]:
    from shmgen.core.diagnostics import Rejected
    from shmgen.live.regions import View
    from shmgen.runtime import ShmError, region_name
    from shmgen.tools.messages.paths import leaves

    words = os.environ.get("COMP_WORDS", "").split()  # what click gives is empty behind an option
    named = context.params.get("topic") or next((word for word in words if word in topics(context, parameter, "")), "")
    try:
        with View(region_name(named)) as view:
            header = view.header()
        session = registry(context.params.get("config_file"), context.params.get("include") or ()).session_of(
            header.type_name, header.digest
        )
        layout, layouts = session.layout(header.type_name), session.layouts([header.type_name])
    except (ShmError, Rejected, ValueError, OSError):
        return []
    return [path for path in leaves(layout, layouts, numbers=numbers) if path.startswith(incomplete)]


def _load(context: click.Context) -> Config:
    return options.load(context.params.get("config_file"), context.params.get("include") or ())


topic = click.argument("topic", shell_complete=topics)
for_machines = click.option("--json", "as_json", is_flag=True, help="Print JSON.")
count = click.option("-n", "--count", type=click.IntRange(1), help="Stop after this many.")
timeout = click.option(
    "--timeout", type=click.FloatRange(0), help="Exit with 1 after this many seconds without a sample."
)


def registry(file: Path | None, include: tuple[Path, ...]) -> ClassRegistry:
    from shmgen.live.classes import ClassRegistry
    from shmgen.live.config_of_lock import LOCK
    from shmgen.live.session import Session

    config = options.load(file, include)
    found = options.file_in_force(file)
    lock = Path(os.path.relpath(config.root / LOCK))
    name = found.name if found else "the defaults, as there is no shmgen.toml here"
    return ClassRegistry(Session(config, name), lock)


class Report(Protocol):
    """What tools print line by line."""

    def plain(self) -> Mapping[str, Any]: ...


def show(reports: Generator[Report, None, None], most: int | None, as_json: bool) -> None:
    """One after the other, so many at most."""
    try:
        for report in islice(reports, most):
            click.echo(json.dumps(report.plain()) if as_json else str(report))
    finally:
        reports.close()


def note(text: str) -> None:
    from shmgen.core.escape import lines

    click.echo(click.style(lines(text), fg="yellow"), err=True)


def complain(text: str) -> None:
    from shmgen.core.escape import lines

    first, _, rest = lines(text).partition("\n")
    click.echo(click.style("error: ", fg="red", bold=True) + first, err=True)
    if rest:
        click.echo(rest, err=True)


def fail(text: str) -> NoReturn:
    complain(text)
    sys.exit(1)


def can_overwrite(stream: TextIO) -> bool:
    """Whether it is a terminal on which a line can be written over."""
    return stream.isatty() and os.environ.get("TERM", "dumb") != "dumb"


def fitting(line: str) -> str:
    """What of a line a terminal shows in one."""
    return line[: max(1, shutil.get_terminal_size().columns - 1)]


def shows_unicode(stream: TextIO) -> bool:
    """Whether more than ASCII is likely to be shown as it is."""
    return "utf" in (stream.encoding or "").lower() and os.environ.get("TERM") != "dumb"
