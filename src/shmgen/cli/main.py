"""The `shmgen` command: its families of commands, and the handling of errors."""

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
from shmgen.cli import check_cache, options
from shmgen.core.diagnostics import Diagnostic, Rejected, Span, closest


def main() -> None:
    """Run the `shmgen` command. Exit with 0 on success, 1 after diagnostics, 2 for wrong usage."""
    color = False if os.environ.get("NO_COLOR") or os.environ.get("TERM") == "dumb" else None
    with click.Context(cli, color=color).scope():  # for messages after the command has ended
        try:
            if isinstance(sys.stdout, io.TextIOWrapper):
                # Replace characters that the terminal cannot show, instead of failing. Flushes: see _output_full().
                sys.stdout.reconfigure(errors="replace")
            if cache_key := check_cache.static_key():
                _run_and_cache(cache_key, color)
            cli(standalone_mode=True, color=color)
        except Rejected as rejected:
            options.print_diagnostics(rejected.diagnostics)
            sys.exit(1)
        except Exception as error:
            if os.environ.get("SHMGEN_DEBUG"):
                raise
            options.print_diagnostics([_output_full(error) or _no_access(error) or _internal_error(error)])
            sys.exit(1)


def _run_and_cache(cache_key: Sequence[str], color: bool | None) -> None:
    """Run the command line of this process, print its output, and store the output in the cache under `cache_key`."""
    began, code = time.time_ns(), None
    with redirect_stdout(io.TextIOWrapper(io.BytesIO(), encoding="utf-8")) as printed:
        try:
            cli(standalone_mode=True, color=color)
        except SystemExit as end:
            code = end.code
    printed.seek(0)
    text = printed.read()
    if not code:
        check_cache.store(cache_key, text, (), (), began)
    click.echo(text, nl=False)
    sys.exit(code)


def _output_full(error: Exception) -> Diagnostic | None:
    """Return the diagnostic SHM007 if standard output cannot be written (full disk), or None for other errors."""
    if not isinstance(error, OSError) or error.errno not in _FULL or error.filename:
        return None
    os.dup2(os.open(os.devnull, os.O_WRONLY), 1)  # the remaining output would fail again at exit
    hint = "free space on the disk that stores the output of this command"
    return Diagnostic("SHM007", f"cannot write: {error.strerror}", Span("standard output"), hint=hint)


_FULL = (errno.ENOSPC, errno.EDQUOT, errno.EFBIG, errno.EIO)


def _no_access(error: Exception) -> Diagnostic | None:
    """Return the diagnostic SHM001 if this user may not read a file or search a folder, or None for other errors."""
    if not isinstance(error, PermissionError) or not isinstance(error.filename, str):
        return None
    folder = os.path.dirname(error.filename) or "."
    hint = f"give this user access (`ls -ld '{folder}'` shows who has it), or run shmgen elsewhere"
    return Diagnostic("SHM001", f"cannot open: {error.strerror}", Span(error.filename), hint=hint)


def _internal_error(error: Exception) -> Diagnostic:
    hint = "this is a bug in shmgen, not an error in your input: run again with SHMGEN_DEBUG=1 and report the output"
    return Diagnostic("SHM901", f"{type(error).__name__}: {error}", Span("shmgen"), hint=hint)


GROUPS = {
    "Generate": {"generate": "generate", "list": "generate", "show": "generate", "types": "generate"},
    "Check": {"check": "drift", "diff": "drift", "explain": "generate"},
    "Bridge": {"bridge": "bridge"},
    "Live": {
        **dict.fromkeys(("topics", "info"), "look"),
        **dict.fromkeys(("top", "echo", "pub", "call"), "live"),
        **dict.fromkeys(("hz", "bw", "delay"), "look"),
        **dict.fromkeys(("doctor", "clean"), "live"),
    },
    "Record and view": {"record": "bag", "play": "bag", "view": "view"},
    "PLC": {"import": "plc", "selftest": "plc"},
    "Setup": {"init": "drift", "schema": "generate", "completion": "look"},
}
"""The commands of each group in the help, and the module of `shmgen.cli` that contains the command."""
_MODULES = {name: module for group in GROUPS.values() for name, module in group.items()}


def _print_version(context: click.Context) -> None:
    text = f"shmgen, version {__version__}"
    if options.HAS_REGIONS:
        from shmgen.runtime.engine import IN_C  # only this option needs the runtime

        text += f"; publish and read in {'C' if IN_C else 'Python'}"
    click.echo(text)
    context.exit()


class _Groups(click.Group):
    """The group of all commands of `shmgen`. A command's module is imported only when the command is used."""

    def list_commands(self, context: click.Context) -> list[str]:
        return list(_MODULES)

    def get_command(self, context: click.Context, name: str) -> click.Command | None:
        module = _MODULES.get(name)
        if module in _LIVE_MODULES and name != "completion" and not options.HAS_REGIONS:
            return _linux_only(name)
        commands = importlib.import_module(f"shmgen.cli.{module}").COMMANDS if module else ()
        return next((command for command in commands if command.name == name), None)

    def format_commands(self, context: click.Context, formatter: click.HelpFormatter) -> None:
        """Write the commands in groups, each with its summary. All groups have the same column width."""
        width = max(map(len, _MODULES))
        for title, names in GROUPS.items():
            commands = [(name, self.get_command(context, name)) for name in names]
            with formatter.section(title):
                formatter.write_dl(
                    [(f"{name:<{width}}", command.get_short_help_str(99)) for name, command in commands if command]
                )

    def invoke(self, context: click.Context) -> Any:
        """Run a command. If click reports wrong usage without the usage line of the command, add this line."""
        try:
            return super().invoke(context)
        except click.UsageError as error:
            if error.ctx is None and (command := self.get_command(context, name := context.invoked_subcommand or "")):
                error.ctx = click.Context(command, info_name=name, parent=context)
            raise

    def resolve_command(self, context: click.Context, words: list[str]) -> Any:
        known = {**{name: name for name in self.list_commands(context)}, "help": "--help", "version": "--version"}
        known["plot"] = "view --terminal"  # a command of older versions
        suggestion = known.get(words[0]) or next((name for name in known if name.startswith(words[0])), "")
        suggestion = suggestion or known.get(closest(words[0], known), "")
        if words[0] != suggestion and suggestion:
            context.fail(f"no command is called {words[0]!r}; did you mean `shmgen {suggestion}`?")
        return super().resolve_command(context, words)


_LIVE_MODULES = ("bridge", "live", "look", "bag", "view")


def _linux_only(name: str) -> click.Command:
    """Return a substitute for the command `name` on a machine without /dev/shm. It only reports that reason."""
    message = f"`shmgen {name}` needs shared memory in /dev/shm, which exists only on Linux"
    hint = "run it on the Linux machine where the PLC runs"

    @click.command(
        name,
        help=f"{message}: {hint}.",
        short_help="Works on Linux only, beside the PLC.",
        context_settings={"ignore_unknown_options": True},
    )
    @click.argument("anything", nargs=-1)
    def command(anything: tuple[str, ...]) -> None:
        raise Rejected([Diagnostic("SHM702", message, Span("command line"), hint=hint)])

    return command


@click.group(cls=_Groups, context_settings={"help_option_names": ["-h", "--help"], "max_content_width": 100})
@click.option(
    "-V",
    "--version",
    is_flag=True,
    is_eager=True,
    expose_value=False,
    callback=lambda context, _, is_requested: _print_version(context) if is_requested else None,
    help="Show the version and exit.",
)
def cli() -> None:
    """Generate code that connects soft PLCs and ROS through shared memory.

    \b
    shmgen list                         list the available messages
    shmgen show geometry_msgs/Pose      print the byte layout of a message
    shmgen generate geometry_msgs/Pose  generate Python, Structured Text and C
    shmgen bridge                       connect ROS topics to shared memory
    shmgen doctor                       find faults in the shared memory of topics
    """  # noqa: D301 click's own sign
