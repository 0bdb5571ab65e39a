"""The command view: screens in this terminal, or a page of the browser on this machine."""

from __future__ import annotations

import shlex
import socket
import sys

import click

from shmgen.cli import common, options
from shmgen.core.diagnostics import Diagnostic, Rejected, Span


@click.command()
@click.argument("topic", required=False, shell_complete=common.topics)
@click.argument("fields", nargs=-1, metavar="[FIELD]...", shell_complete=common.numbers)
@click.option("-t", "--terminal", is_flag=True, help="Use this terminal (also over ssh) instead of the browser.")
@click.option(
    "-p",
    "--port",
    type=click.IntRange(0, 65535),
    default=8642,
    show_default=True,
    help="Port of the page; 0 selects a free port.",
)
@click.option("--open", "opens", is_flag=True, help="Open the page in the browser.")
@click.option(
    "--allow-write",
    is_flag=True,
    help="Let the user publish samples by hand. Off by default, because a sample may move a machine.",
)
@options.source_options
@common.report_errors
def view(
    topic: str | None,
    fields: tuple[str, ...],
    terminal: bool,
    port: int,
    opens: bool,
    allow_write: bool,
    source: options.Source,
) -> None:
    """Show topics in shared memory in the browser or in the terminal.

    \b
    Plot two fields of a topic in the terminal:
    shmgen view --terminal /arm/pose position.x position.y

    The page in the browser shows all topics, and the fields, plots and bytes of one topic. The command serves the page
    on 127.0.0.1 and prints the address, which contains the token required for access. The command requires the extra
    `view` (`pip install '.[view]'` in a checkout), but no internet.
    """  # noqa: D301 click's own sign
    try:
        import textual  # noqa: F401
        import textual_plotext  # noqa: F401

        if not terminal:
            from shmgen.view.serve import HOST, Page
    except ImportError as error:
        hint = "install the extra `view`: `pip install '.[view]'` in a checkout of shmgen"
        message = f"`shmgen view` needs {error.name}, which is not installed"
        raise Rejected([Diagnostic("SHM706", message, Span("command line"), hint=hint)]) from None
    if terminal:
        _in_terminal(topic, fields, allow_write, source)
        return
    common.registry(source)  # reports errors in shmgen.toml before the page starts
    try:
        listening = socket.create_server((HOST, port))
    except OSError as error:
        hint = "choose another port with --port; 0 selects a free port"
        raise Rejected([Diagnostic("SHM702", str(error.strerror), Span(f"port {port}"), hint=hint)]) from None
    words = [sys.executable, "-m", "shmgen", "view", "--terminal", *([topic] if topic else []), *fields]
    words += ["--allow-write"] if allow_write else []
    words += ["-c", str(source.file)] if source.file else []
    words += [word for folder in source.include for word in ("-I", str(folder))]

    page = Page(shlex.join(words), listening, click.echo)
    click.echo(f"{page.address}\nCtrl-C stops the server")
    if opens and click.launch(page.create_redirect_file()):
        common.note("cannot start a browser, because xdg-open is missing; open the address yourself")
    page.serve()


def _in_terminal(topic: str | None, fields: tuple[str, ...], allow_write: bool, source: options.Source) -> None:
    import os

    from shmgen.view.app import Viewer

    driven = bool(os.environ.get("TEXTUAL_DRIVER"))
    if not driven and not common.can_draw():
        hint = "run it in a terminal; `shmgen topics` and `shmgen echo` print lines"
        raise Rejected([Diagnostic("SHM702", "no terminal to draw on", Span("standard output"), hint=hint)])
    Viewer(common.registry(source), allow_write=allow_write, topic=topic, fields=fields).run()


COMMANDS = (view,)
