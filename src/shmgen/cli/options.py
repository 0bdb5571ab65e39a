"""The options that say where things are, which all commands share, and the Config that they lead to."""

from __future__ import annotations

import os
import sys
from collections.abc import Callable, Iterable
from dataclasses import replace
from pathlib import Path
from typing import Any, TypeVar

import click

from shmgen import config as configuration
from shmgen.config import Config
from shmgen.core import cache
from shmgen.core.diagnostics import Diagnostic, Report
from shmgen.core.escape import lines

F = TypeVar("F", bound=Callable[..., Any])
HAS_REGIONS = sys.platform.startswith("linux")


def _without_cache(context: click.Context, parameter: click.Parameter, value: bool) -> None:
    """Until the command has ended."""
    if value and not os.environ.get(cache.OFF):
        os.environ[cache.OFF] = "1"
        context.call_on_close(lambda: os.environ.pop(cache.OFF, None))


def where(command: F) -> F:
    """The options that say where things are: `config_file` and `include`; and `--no-cache`."""
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
            help="Folder to search for message packages, before all others; may be repeated.",
        ),
        click.option(
            "--no-cache",
            is_flag=True,
            is_eager=True,
            expose_value=False,
            callback=_without_cache,
            help=f"Do not use the cache; the same as setting {cache.OFF}.",
        ),
    ):
        command = option(command)
    return command


def load(file: Path | None, include: Iterable[Path]) -> Config:
    """The configuration in force. Raises Rejected."""
    found = file_in_force(file)
    config = configuration.load(found, str(found if file else found.name), Report()) if found else Config(Path.cwd())
    return replace(config, path=(*(folder.absolute() for folder in include), *config.path))


def file_in_force(file: Path | None) -> Path | None:
    """The one named, else that of this folder, if it has one."""
    return file or configuration.find(Path.cwd())


def complain(diagnostics: Iterable[Diagnostic], *, to_stderr: bool = True) -> None:
    """Prints them, in colour on a terminal."""
    for diagnostic in diagnostics:
        first, _, rest = lines(str(diagnostic)).partition("\n")
        where, mark, message = first.partition(f": {diagnostic.level}[")
        colour = "red" if diagnostic.level == "error" else "cyan"
        click.echo(click.style(where, bold=True) + click.style(mark + message, fg=colour), err=to_stderr)
        if rest:
            click.echo(rest, err=to_stderr)
