"""The command view: screens in this terminal, or a page of the browser on this machine."""

from __future__ import annotations

import shlex
import socket
import sys
from pathlib import Path

import click

from shmgen.cli import common, options

_MISSING = "`shmgen view` needs {name}, which is not installed: `pip install '.[view]'` in a checkout of shmgen"


@click.command()
@click.argument("topic", required=False, shell_complete=common.topics)
@click.option("-t", "--terminal", is_flag=True, help="Use this terminal (also over ssh) instead of the browser.")
@click.option(
    "-p",
    "--port",
    type=click.IntRange(0, 65535),
    default=8642,
    show_default=True,
    help="Port of the page; 0 selects a free one.",
)
@click.option("--open", "opens", is_flag=True, help="Open the page in the browser.")
@click.option("--allow-write", is_flag=True, help="Allow publishing by hand. Off by default: samples move machines.")
@options.where
@common.polite
def view(
    topic: str | None,
    terminal: bool,
    port: int,
    opens: bool,
    allow_write: bool,
    config_file: Path | None,
    include: tuple[Path, ...],
) -> None:
    """Show live regions in the browser or terminal: table, fields, plots, memory.

    Serves a page on 127.0.0.1 and prints its address; the token in the address is required for access. Needs the
    extra `view` (`pip install '.[view]'` in a checkout) and no internet.
    """
    try:
        import textual  # noqa: F401
        import textual_plotext  # noqa: F401

        if not terminal:
            from shmgen.view.serve import HOST, Page
    except ImportError as error:
        raise ValueError(_MISSING.format(name=error.name)) from None
    if terminal:
        _in_terminal(topic, allow_write, config_file, include)
        return
    common.registry(config_file, include)  # what is wrong with shmgen.toml is told here
    try:
        listening = socket.create_server((HOST, port))
    except OSError as error:
        raise OSError(f"port {port}: {error.strerror}\n  hint: choose another with --port, or 0") from None
    words = [sys.executable, "-m", "shmgen", "view", "--terminal", *([topic] if topic else [])]
    words += ["--allow-write"] if allow_write else []
    words += ["-c", str(config_file)] if config_file else []
    words += [word for folder in include for word in ("-I", str(folder))]

    page = Page(shlex.join(words), listening, click.echo)
    click.echo(f"{page.address}\nCtrl-C ends it")
    if opens and click.launch(page.door()):
        common.note("no browser could be started: xdg-open is missing; open the address")
    page.serve()


def _in_terminal(topic: str | None, allow_write: bool, config_file: Path | None, include: tuple[Path, ...]) -> None:
    import os

    from shmgen.view.app import Viewer

    driven = bool(os.environ.get("TEXTUAL_DRIVER"))
    if not driven and not (sys.stdin.isatty() and common.can_overwrite(sys.stdout)):
        raise ValueError("there is no terminal to draw on; `shmgen topics` and `shmgen echo` print lines")
    Viewer(common.registry(config_file, include), allow_write=allow_write, topic=topic).run()


COMMANDS = (view,)
