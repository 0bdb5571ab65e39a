"""The commands check, diff and init."""

from __future__ import annotations

import errno
import os
import sys
import time
from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any, TypeVar

import click

from shmgen.cli import options
from shmgen.core.diagnostics import Diagnostic, Rejected, Span
from shmgen.core.plural import counted
from shmgen.drift.findings import Finding, Severity, as_annotations, as_json, summary, worst
from shmgen.targets import KEYS

F = TypeVar("F", bound=Callable[..., Any])

_output = click.option(
    "-o",
    "--output",
    type=click.Path(path_type=Path, file_okay=False),
    default=Path("generated"),
    show_default=True,
    help="Folder of the generated files.",
)


def _report(command: F) -> F:
    """How findings are told, and which of them count: `form` and `fail_on`."""
    for option in (
        click.option(
            "--fail-on",
            type=click.Choice([severity.name.lower() for severity in reversed(Severity)]),
            default="cosmetic",
            show_default=True,
            help="Lowest severity that makes the exit code 1; anything below is printed as a note.",
        ),
        click.option("--json", "form", flag_value="json", help="The same as --format json."),
        click.option(
            "--format",
            "form",
            type=click.Choice(["text", "json", "github"]),
            default="text",
            show_default=True,
            help="Output format; github prints workflow annotations.",
        ),
    ):
        command = option(command)
    return command


@click.command()
@_output
@click.option("-t", "--target", multiple=True, type=click.Choice(KEYS), help="As for generate.")
@click.option("--diff", "with_diff", is_flag=True, help="Print what generate would change, as a patch.")
@_report
@options.where
def check(
    output: Path,
    target: tuple[str, ...],
    with_diff: bool,
    form: str,
    fail_on: str,
    config_file: Path | None,
    include: tuple[Path, ...],
) -> None:
    """Check that definitions, generated files and layout.lock agree. Writes nothing.

    Exits with 0 if `shmgen generate` would change nothing, otherwise 1. Severities: breaking (bytes moved, rebuild
    both sides), compatible (comments, constants, defaults) and cosmetic (text only).
    """
    from shmgen.cli import requested
    from shmgen.core.write import current
    from shmgen.drift import check as checking
    from shmgen.drift import lockfile

    began = time.time_ns()
    severity = Severity[fail_on.upper()]
    texts: dict[str, str] = {}
    try:
        config = options.load(config_file, include)
        config = replace(config, targets=target) if target else config
        lock, formerly = requested.former(output, current(output, lockfile.LOCK))
        config = replace(config, skip_unbounded=lock.settings.get("skip_unbounded") is True)
        requests = requested.configured(config) or list(lock.requested)
        if requests or (output / lockfile.LOCK).is_file():
            texts = requested.texts(config, requests, formerly, output)
        findings = checking.check(texts, output)
    except Rejected as rejected:
        if form == "text":
            raise
        findings = [Finding(Severity.BREAKING, found) for found in rejected.diagnostics]
    if findings:
        _tell(findings, form, severity, to_stderr=True)
        if with_diff and form == "text":
            click.echo(checking.differences(texts, output), nl=False)
        sys.exit((worst(findings) or 0) >= severity)
    messages = sum(line.startswith("[messages.") for line in texts[lockfile.LOCK].splitlines())
    said = f"{output}: up to date, {counted(messages, 'message')} in {counted(len(texts), 'file')}"
    if form == "text":
        click.echo(said)
        files = [os.path.join(output, path) for path in texts]
        requested.remember(f"{said}\n", config, requests, config_file, files, began)
    else:
        click.echo(as_json([]) if form == "json" else "", nl=False)


@click.command()
@click.argument("old")
@click.argument("new")
@_output
@_report
def diff(old: str, new: str, output: Path, form: str, fail_on: str) -> None:
    """Compare message layouts between two git revisions or layout.lock files.

    OLD and NEW are each a layout.lock, its folder or a git revision. Exits with 1 if anything of the severity
    given by --fail-on, or above, changed.
    """
    from shmgen.drift import revisions
    from shmgen.drift.compare import compare

    severity = Severity[fail_on.upper()]
    (before, _), (after, shown) = (revisions.lock(name, output) for name in (old, new))
    findings = compare(before, after, shown)
    _tell(findings, form, severity, to_stderr=False)
    sys.exit((worst(findings) or 0) >= severity)


@click.command()
@click.option(
    "--hook", is_flag=True, help="Also write .pre-commit-config.yaml, which runs `shmgen check` before each commit."
)
@click.option("--ci", is_flag=True, help="Also write .github/workflows/shmgen.yml, which runs it on each push.")
@click.option(
    "--from",
    "wanted",
    metavar="REQUIREMENT",
    help="What pip installs in CI, such as 'shmgen[idl] @ git+https://HOST/shmgen'.  [default: this shmgen's origin]",
)
def init(hook: bool, ci: bool, wanted: str | None) -> None:
    """Write shmgen.toml for the message packages in the current folder.

    Asks no questions and leaves existing files as they are.
    """
    import shlex

    from shmgen.cli import init, install_source

    requirement = (wanted or install_source.requirement()) if ci else ""
    if requirement is None:
        said = "--ci: this shmgen was installed from a folder, which a CI machine does not have"
        raise click.UsageError(
            f"{said}; add --from 'shmgen[idl] @ git+https://HOST/shmgen', or whatever pip is to install there"
        )
    begun = init.begin(Path.cwd())
    files = {"shmgen.toml": begun.configuration} if begun.configuration else {}
    files |= {init.HOOK_FILE: init.HOOK} if hook else {}
    files |= {init.CI_FILE: init.CI.format(requirement=shlex.quote(requirement))} if ci else {}
    for path, text in files.items():
        file = Path(path)
        if os.path.lexists(file):
            click.echo(f"{path} is there, and left as it is; this would be its content:\n\n{text}")
        else:
            try:
                for parent in (file.parent, *file.parent.parents):
                    if parent.is_symlink():
                        raise OSError(errno.ELOOP, f"{parent} is a symbolic link")
                file.parent.mkdir(parents=True, exist_ok=True)
                file.write_bytes(text.encode())  # with the same line ends everywhere
            except OSError as error:
                found = Diagnostic("SHM007", f"cannot write: {error.strerror}", Span(path))
                raise Rejected([found]) from error
            click.echo(f"{path} written")
    click.echo("\n".join(begun.advice))
    if hook:
        click.echo("  pre-commit install    once in each clone; to have it: pipx install pre-commit")


COMMANDS = (check, diff, init)


def _tell(findings: Sequence[Finding], form: str, fail_on: Severity, *, to_stderr: bool) -> None:
    if form == "json":
        click.echo(as_json(findings), nl=False)
    elif form == "github":
        click.echo(as_annotations(findings, fail_on), nl=False)
    else:
        for found in findings:
            level = found.diagnostic.level if found.severity >= fail_on else "note"
            options.complain([replace(found.diagnostic, level=level)], to_stderr=to_stderr)
        click.echo(summary(findings) or "no difference", err=to_stderr)
