"""The `shmgen` command: its families of commands, and how an error ends each of them."""

from __future__ import annotations

import errno
import importlib
import io
import os
import sys
import time
from collections.abc import Sequence
from contextlib import redirect_stdout
from typing import Any

import click

from shmgen import __version__
from shmgen.cli import options
from shmgen.core.diagnostics import Diagnostic, Rejected, Span, closest
from shmgen.drift import check_cache


def main() -> None:
    """The `shmgen` command. Exit 0 clean, 1 diagnostics, 2 wrong usage."""
    color = False if os.environ.get("NO_COLOR") or os.environ.get("TERM") == "dumb" else None
    with click.Context(cli, color=color).scope():  # for what is told once the command has ended
        try:
            if isinstance(sys.stdout, io.TextIOWrapper):
                # A sign in a comment that the terminal does not know is no reason to stop. This flushes: see _full.
                sys.stdout.reconfigure(errors="replace")
            if fixed := check_cache.fixed():
                _answer(fixed, color)
            cli(standalone_mode=True, color=color)
        except Rejected as rejected:
            options.complain(rejected.diagnostics)
            sys.exit(1)
        except Exception as error:
            if os.environ.get("SHMGEN_DEBUG"):
                raise
            options.complain([_full(error) or _fault(error)])
            sys.exit(1)


def _answer(fixed: Sequence[str], color: bool | None) -> None:
    """The same, and remembers it."""
    began, code = time.time_ns(), None
    with redirect_stdout(io.TextIOWrapper(io.BytesIO(), encoding="utf-8")) as printed:
        try:
            cli(standalone_mode=True, color=color)
        except SystemExit as end:
            code = end.code
    printed.seek(0)
    said = printed.read()
    if not code:
        check_cache.store(fixed, said, (), (), began)
    click.echo(said, nl=False)
    sys.exit(code)


def _full(error: Exception) -> Diagnostic | None:
    """Where what we print goes to a full disk. What we write into files of our own is told by their names."""
    if not isinstance(error, OSError) or error.errno not in _FULL or error.filename:
        return None
    os.dup2(os.open(os.devnull, os.O_WRONLY), 1)  # what is left to print would fail again at the end
    hint = "make room where the output of this command goes"
    return Diagnostic("SHM007", f"cannot write: {error.strerror}", Span("standard output"), hint=hint)


_FULL = (errno.ENOSPC, errno.EDQUOT, errno.EFBIG, errno.EIO)


def _fault(error: Exception) -> Diagnostic:
    hint = "this is a fault of shmgen, not of your input: run again with SHMGEN_DEBUG=1 and report what it prints"
    return Diagnostic("SHM901", f"{type(error).__name__}: {error}", Span("shmgen"), hint=hint)


_FAMILIES = {
    "generate": ("generate", "show", "types", "list", "explain", "schema"),
    "drift": ("check", "diff", "init"),
    "plc": ("import", "selftest"),
    "bridge": ("bridge",),
    "live": ("doctor", "clean", "echo", "pub", "call", "hz", "top"),
    "look": ("topics", "info", "bw", "delay", "plot", "completion"),
    "bag": ("record", "play"),
    "view": ("view",),
}


def _say_version(context: click.Context) -> None:
    said = f"shmgen, version {__version__}"
    if options.HAS_REGIONS:
        from shmgen.runtime.engine import IN_C  # nothing else asked here needs the runtime

        said += f"; publish and read in {'C' if IN_C else 'Python'}"
    click.echo(said)
    context.exit()


class _Families(click.Group):
    """Loads the module of the one command that is asked for; for a list of them, all."""

    def list_commands(self, context: click.Context) -> list[str]:
        return sorted(name for names in _FAMILIES.values() for name in names)

    def get_command(self, context: click.Context, name: str) -> click.Command | None:
        family = next((family for family, names in _FAMILIES.items() if name in names), None)
        if family in _LIVE and name != "completion" and not options.HAS_REGIONS:
            return _elsewhere(name)
        commands = importlib.import_module(f"shmgen.cli.{family}").COMMANDS if family else ()
        return next((command for command in commands if command.name == name), None)

    def resolve_command(self, context: click.Context, words: list[str]) -> Any:
        known = {**{name: name for name in self.list_commands(context)}, "help": "--help", "version": "--version"}
        meant = known.get(words[0]) or next((name for name in known if name.startswith(words[0])), "")
        meant = meant or known.get(closest(words[0], known), "")
        if words[0] != meant and meant:
            context.fail(f"no command is called {words[0]!r}; did you mean `shmgen {meant}`?")
        return super().resolve_command(context, words)


_LIVE = ("bridge", "live", "look", "bag", "view")


def _elsewhere(name: str) -> click.Command:
    """In the place of a command that works on regions."""
    said = f"`shmgen {name}` works on regions in /dev/shm: run it on the Linux machine where the PLC runs"

    @click.command(name, help=said, context_settings={"ignore_unknown_options": True})
    @click.argument("anything", nargs=-1)
    def command(anything: tuple[str, ...]) -> None:
        raise click.ClickException(said)

    return command


@click.group(cls=_Families, context_settings={"help_option_names": ["-h", "--help"], "max_content_width": 100})
@click.option(
    "-V",
    "--version",
    is_flag=True,
    is_eager=True,
    expose_value=False,
    callback=lambda context, _, asked: _say_version(context) if asked else None,
    help="Show the version and exit.",
)
def cli() -> None:
    """Generate code that connects softPLCs and ROS through shared memory.

    \b
    shmgen list                          list the messages that can be generated
    shmgen show geometry_msgs/Pose       print the byte layout of a message
    shmgen generate geometry_msgs/Pose   generate matching Python, Structured Text and C
    shmgen bridge                        carry topics between ROS and shared memory
    shmgen doctor                        diagnose the live regions of this machine
    """  # noqa: D301 click's own sign
