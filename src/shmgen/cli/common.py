"""Common parts of the commands for live regions: exit codes, shared options, completion, and messages on stderr."""

from __future__ import annotations

import functools
import os
import shutil
import signal
import sys
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, Any, TextIO, TypeVar

import click

from shmgen.cli import options
from shmgen.core.diagnostics import Diagnostic, Rejected, Span
from shmgen.core.escape import lines

if TYPE_CHECKING:
    from shmgen.live.classes import ClassRegistry

F = TypeVar("F", bound=Callable[..., Any])


def report_errors(command: F) -> F:
    """Wrap the function of a command: convert its errors to diagnostics, and clean up if a signal ends the command.

    Ctrl-C ends the command with exit code 0, as in `ros2 topic`. SIGTERM ends the command with exit code 143. In both
    cases, no lock stays held.
    """

    @functools.wraps(command)
    def run(*arguments: Any, **keywords: Any) -> Any:
        from shmgen.runtime import ShmError

        former = signal.signal(signal.SIGTERM, lambda *_: sys.exit(128 + signal.SIGTERM))
        try:
            return command(*arguments, **keywords)
        except KeyboardInterrupt:
            signal.signal(signal.SIGINT, signal.SIG_IGN)  # ignore a second Ctrl-C
            sys.exit(0)
        except BrokenPipeError:
            raise
        except (ShmError, ValueError, OSError) as error:
            place = keywords.get("topic") or keywords.get("service") or "command line"
            value_hint = _HINTS["SHM704"].replace("TYPE", keywords.get("type_name") or "TYPE")
            raise Rejected([diagnostic(error, place, value_hint)]) from error
        finally:
            signal.signal(signal.SIGTERM, former)

    return run  # type: ignore[return-value]


def topics(context: click.Context, parameter: click.Parameter, incomplete: str) -> list[str]:
    """Return the names of live topics that begin with `incomplete`, for shell completion."""
    from shmgen.live import regions

    topics = [regions.topic_of(name) for name in regions.live()]
    return [topic for topic in topics if topic.startswith("/" + incomplete.removeprefix("/"))]


def services(context: click.Context, parameter: click.Parameter, incomplete: str) -> list[str]:
    return [topic.removesuffix("-request") for topic in topics(context, parameter, incomplete) if "-request" in topic]


def types(context: click.Context, parameter: click.Parameter, incomplete: str) -> list[str]:
    """Return the types that begin with `incomplete`, for shell completion.

    Without a slash in `incomplete`, return packages instead, such as `geometry_msgs/`.
    """
    from shmgen.generator import pipeline

    names = [name.short for name in pipeline.library(_source(context).load()).known()]
    matching = [name for name in names if name.startswith(incomplete)]
    return matching if "/" in incomplete else sorted({name.partition("/")[0] + "/" for name in matching})


def fields(context: click.Context, parameter: click.Parameter, incomplete: str, *, numbers: bool = False) -> list[str]:
    """Return the paths of fields that begin with `incomplete`, such as `position.x`, for shell completion.

    The fields are those of the topic on the command line. If `numbers` is true, return only numeric fields, which can
    be plotted.
    """
    from shmgen.live.regions import View
    from shmgen.runtime import ShmError, region_name
    from shmgen.show.table import leaves

    words = os.environ.get("COMP_WORDS", "").split()  # click's own words are empty after an option
    named = context.params.get("topic") or next(filter(topics(context, parameter, "").__contains__, words), "")
    try:
        with View(region_name(named)) as view:
            header = view.header()
        session = registry(_source(context)).session_of(header.type_name, header.digest)
        layout, layouts = session.layout(header.type_name), session.layouts([header.type_name])
    except (ShmError, Rejected, ValueError, OSError):
        return []
    rows = [row for row in leaves(layout, layouts) if row.role == "data" and row.path.startswith(incomplete)]
    return [row.path for row in rows if not numbers or not ("[" in row.ros or "string" in row.ros)]


numbers = functools.partial(fields, numbers=True)


def _source(context: click.Context) -> options.Source:
    return options.Source(context.params.get("config_file"), context.params.get("include") or ())


topic = click.argument("topic", shell_complete=topics)
json_option = click.option("--json", "as_json", is_flag=True, help="Print JSON.")


def count(unit: str) -> Callable[[F], F]:
    """Return the option -n, which stops a command after a number of samples, reports or tables."""
    return click.option("-n", "--count", type=click.IntRange(1), help=f"Stop after this many {unit}.")


timeout = click.option(
    "--timeout", type=click.FloatRange(0), help="Exit with 1 after this many seconds without a sample."
)


def registry(source: options.Source) -> ClassRegistry:
    from shmgen.live.classes import ClassRegistry
    from shmgen.live.config_of_lock import LOCK
    from shmgen.live.session import Session

    config, file_used = source.load(), source.file_used()
    lock = Path(os.path.relpath(config.root / LOCK))
    name = file_used.name if file_used else "the defaults, as there is no shmgen.toml here"
    return ClassRegistry(Session(config, name), lock)


def note(text: str) -> None:
    click.echo(click.style(lines(text), fg="yellow"), err=True)


_CODES = {
    "RegionMissing": "SHM701",
    "TimeoutError": "SHM701",
    "FileNotFoundError": "SHM001",
    "PermissionError": "SHM001",
    "CallTimeout": "SHM703",
    "CallFailed": "SHM703",
    "Unreadable": "SHM705",
    "BackendMissing": "SHM706",
    "ValueRejected": "SHM704",
    "ShmError": "SHM702",
    "OSError": "SHM702",
    "ValueError": "SHM704",
}
"""Name of an exception class -> code. Names, because most of the modules with these classes are not loaded."""
_HINTS = {
    "SHM001": "check the path, and its permissions with `ls -ld`",
    "SHM701": "`shmgen topics` lists the live regions",
    "SHM702": "`shmgen doctor` lists faults of live regions, and how to fix them",
    "SHM703": "start the server, and look for its regions with `shmgen topics`",
    "SHM704": "`shmgen show TYPE` lists the fields of a message and their types",
    "SHM705": "name a folder or an .mcap file that `shmgen record` or `ros2 bag record` has written",
    "SHM706": "install the missing package",
}


def diagnostic(error: Exception, place: str = "command line", value_hint: str = _HINTS["SHM704"]) -> Diagnostic:
    """Convert an error to a diagnostic. The text of the error has the form `PLACE: MESSAGE; HINT`.

    * Without a place in the text, `place` is used.
    * The text after `; ` is a hint only if it contains a command in backquotes or begins with `did you mean`.
    * The hint may also be a line `  hint: HINT`; all other lines are details.
    * Without a hint, `value_hint` is used for an invalid value, and a hint for the error's code otherwise.
    """
    code = next(_CODES[kind.__name__] for kind in type(error).__mro__ if kind.__name__ in _CODES)
    if isinstance(error, OSError) and error.strerror:
        where, message, rest = error.filename or place, error.strerror, ""
    else:
        where, message, rest = _parts(str(error), place)
    text, _, hint = rest.partition("  hint: ")
    before, _, last = message.rpartition("; ")
    if not hint and before and ("`" in last or last.startswith("did you mean")):
        message, hint = before, last
    hint = hint or (value_hint if code == "SHM704" else _HINTS[code])
    details = tuple(line.removeprefix("  ") for line in text.splitlines())
    return Diagnostic(code, message, Span(where), hint=hint, details=details)


def _parts(text: str, place: str) -> tuple[str, str, str]:
    """Split the text of an error into its place, its message and the remaining lines.

    If the text begins with no place, `place` is used.
    """
    first, _, rest = text.partition("\n")
    where, colon, message = first.partition(": ")
    return (where, message, rest) if colon and " " not in where else (place, first, rest)


def can_overwrite(stream: TextIO) -> bool:
    """Return True if the stream is a terminal that can overwrite a line."""
    return stream.isatty() and os.environ.get("TERM", "dumb") != "dumb"


def can_draw() -> bool:
    """Return True if standard input and output are a terminal that can draw."""
    return sys.stdin.isatty() and can_overwrite(sys.stdout)


def fitting(line: str) -> str:
    """Shorten a line so that the terminal does not wrap it."""
    return line[: max(1, shutil.get_terminal_size().columns - 1)]
