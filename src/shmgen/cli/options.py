"""The options that many commands share: configuration file, search folders, cache, output folder and target.

A command receives a Source, from which it loads the Config.
"""

from __future__ import annotations

import functools
import os
import sys
from collections.abc import Callable, Iterable
from dataclasses import replace
from pathlib import Path
from typing import Any, NamedTuple, TypeVar

import click

from shmgen import config as configuration
from shmgen.config import Config
from shmgen.core import cache
from shmgen.core.diagnostics import Diagnostic, Report, closest
from shmgen.core.escape import lines
from shmgen.targets import KEYS

F = TypeVar("F", bound=Callable[..., Any])
HAS_REGIONS = sys.platform.startswith("linux")


class Word(click.Choice):  # type: ignore[type-arg]
    """The type of an option whose value is one of several words. An unknown word is rejected with the closest word."""

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> Any:
        try:
            return super().convert(value, param, ctx)
        except click.BadParameter as wrong:
            words = [str(choice) for choice in self.choices]
            small = str(value).lower().replace("-", "_")
            near = small if small in words else closest(small, words, 0.5)
            raise click.BadParameter(f"{wrong.message}{f' Did you mean {near}?' if near else ''}", ctx, param) from None


def _without_cache(context: click.Context, parameter: click.Parameter, value: bool) -> None:
    """Disable the cache until the command has ended."""
    if value and not os.environ.get(cache.OFF):
        os.environ[cache.OFF] = "1"
        context.call_on_close(lambda: os.environ.pop(cache.OFF, None))


def output_folder(help: str, default: str = "generated") -> Callable[[F], F]:
    """Return the option -o with this help text. Its value is a folder."""
    kind = click.Path(path_type=Path, file_okay=False)
    return click.option("-o", "--output", type=kind, default=Path(default), show_default=True, help=help)


def targets(help: str) -> Callable[[F], F]:
    """Return the option -t with this help text. Its value is a target, and the option may be repeated."""
    return click.option("-t", "--target", multiple=True, type=Word(KEYS), metavar="TARGET", help=help)


class Source(NamedTuple):
    """The configuration file and the search folders that the user gave on the command line."""

    file: Path | None = None
    include: tuple[Path, ...] = ()

    def file_used(self) -> Path | None:
        """Return the configuration file from the command line, or the one in the current folder, or None."""
        return self.file or configuration.find(Path.cwd())

    def load(self) -> Config:
        """Load the configuration, and put the folders of -I first in `path`. Raises Rejected if a key is invalid."""
        path, config = self.file_used(), Config(Path.cwd())
        if path:
            config = configuration.load(path, str(path if self.file else path.name), Report())
        return replace(config, path=(*(folder.absolute() for folder in self.include), *config.path))


def source_options(command: F) -> F:
    """Add the options --config, --include and --no-cache to a command. The command receives a Source as `source`."""

    @functools.wraps(command)
    def run(*arguments: Any, config_file: Path | None, include: tuple[Path, ...], **keywords: Any) -> Any:
        return command(*arguments, source=Source(config_file, include), **keywords)

    result: Any = run
    for option in (
        click.option(
            "-c",
            "--config",
            "config_file",
            type=click.Path(path_type=Path),
            help="Configuration file.  [default: shmgen.toml or pyproject.toml in the current folder]",
        ),
        click.option(
            "-I",
            "--include",
            type=click.Path(path_type=Path),
            multiple=True,
            help="Folder with message packages, searched before all other folders; may be repeated.",
        ),
        click.option(
            "--no-cache",
            is_flag=True,
            is_eager=True,
            expose_value=False,
            callback=_without_cache,
            help=f"Ignore the results of earlier runs, as with {cache.OFF}=1 in the environment.",
        ),
    ):
        result = option(result)
    return result  # type: ignore[no-any-return]


def print_diagnostics(diagnostics: Iterable[Diagnostic], *, to_stderr: bool = True) -> None:
    """Print diagnostics, in colour on a terminal."""
    for diagnostic in diagnostics:
        first, _, rest = lines(str(diagnostic)).partition("\n")
        place, mark, message = first.partition(f": {diagnostic.level}[")
        colour = "red" if diagnostic.level == "error" else "cyan"
        click.echo(click.style(place, bold=True) + click.style(mark + message, fg=colour), err=to_stderr)
        if rest:
            click.echo(rest, err=to_stderr)
