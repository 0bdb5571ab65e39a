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
from shmgen.drift.findings import Finding, Severity, as_annotations, as_json, for_people, summary, worst
from shmgen.targets import KEYS

F = TypeVar("F", bound=Callable[..., Any])

_output = options.output_folder("Folder of the generated files.")


def _report(command: F) -> F:
    """Add --format and --json (both set the parameter `form`) and --fail-on (parameter `fail_on`) to a command."""
    for option in (
        click.option(
            "--fail-on",
            type=options.Word([severity.name.lower() for severity in reversed(Severity)]),
            default="cosmetic",
            show_default=True,
            help="Lowest severity that sets exit code 1; shmgen prints lower severities as notes.",
        ),
        click.option("--json", "form", flag_value="json", help="Print JSON; short for --format json."),
        click.option(
            "--format",
            "form",
            type=options.Word(["text", "json", "github"]),
            default="text",
            show_default=True,
            help="Output format; github prints annotations for GitHub workflows.",
        ),
    ):
        command = option(command)
    return command


@click.command()
@_output
@options.targets("Check this target only; may be repeated. `shmgen generate --help` lists the targets.")
@click.option("--diff", "with_diff", is_flag=True, help="Print the changes of `shmgen generate` as a patch.")
@click.option("-q", "--quiet", is_flag=True, help="Print nothing if the files are up to date.")
@_report
@options.source_options
def check(
    output: Path, target: tuple[str, ...], with_diff: bool, quiet: bool, form: str, fail_on: str, source: options.Source
) -> None:
    """Check that definitions, generated files and layout.lock agree.

    The command writes no file. The exit code is 0 if `shmgen generate` would change nothing, otherwise 1. The command
    distinguishes three kinds of changes. Breaking: a field moved or changed its meaning; rebuild the PLC program and
    all other programs. Compatible: comments changed, or constants were added or removed. Cosmetic: no program behaves
    differently.
    """
    from shmgen.cli import requested
    from shmgen.core.write import current
    from shmgen.drift import check as checking
    from shmgen.drift import lockfile

    began = time.time_ns()
    severity = Severity[fail_on.upper()]
    texts: dict[str, str] = {}
    try:
        config = source.load()
        config = replace(config, targets=target) if target else config
        lock, earlier = requested.read_lock(output, current(output, lockfile.LOCK))
        config = replace(config, skip_unbounded=lock.settings.get("skip_unbounded") is True)
        requests = requested.configured(config) or list(lock.requested)
        if requests or (output / lockfile.LOCK).is_file():
            texts = requested.texts(config, requests, earlier, output)
        findings = checking.check(texts, output, KEYS)
    except Rejected as rejected:
        if form == "text":
            raise
        findings = [Finding(Severity.BREAKING, diagnostic) for diagnostic in rejected.diagnostics]
    if findings:
        _tell(findings, form, severity, to_stderr=True)
        if with_diff and form == "text":
            click.echo(checking.differences(texts, output), nl=False)
        sys.exit((worst(findings) or 0) >= severity)
    messages = sum(line.startswith("[messages.") for line in texts[lockfile.LOCK].splitlines())
    output_text = f"{output}: up to date, {counted(messages, 'message')} in {counted(len(texts), 'file')}"
    if form == "text":
        output_text = "" if quiet else f"{output_text}\n"
        click.echo(output_text, nl=False)
        files = [os.path.join(output, path) for path in texts]
        requested.remember(output_text, config, requests, source.file, files, began)
    else:
        click.echo(as_json([]) if form == "json" else "", nl=False)


@click.command()
@click.argument("old")
@click.argument("new")
@_output
@_report
def diff(old: str, new: str, output: Path, form: str, fail_on: str) -> None:
    """Compare the message layouts of two git revisions.

    OLD and NEW are each a git revision, a layout.lock file, or the folder of a layout.lock. The exit code is 1 if a
    change is at least as severe as the value of --fail-on.
    """
    from shmgen.drift import revisions
    from shmgen.drift.compare import compare

    severity = Severity[fail_on.upper()]
    (before, _), (after, shown_path) = (revisions.lock(name, output) for name in (old, new))
    findings = compare(before, after, shown_path)
    _tell(findings, form, severity, to_stderr=False)
    sys.exit((worst(findings) or 0) >= severity)


@click.command()
@click.option(
    "--hook", is_flag=True, help="Also write .pre-commit-config.yaml, which runs `shmgen check` before each commit."
)
@click.option(
    "--ci", is_flag=True, help="Also write .github/workflows/shmgen.yml, which runs `shmgen check` on each push."
)
@click.option(
    "--from",
    "origin",
    metavar="REQUIREMENT",
    help="Package that pip installs in CI, such as 'shmgen[idl] @ git+https://HOST/shmgen'.  "
    "[default: source of this shmgen]",
)
def init(hook: bool, ci: bool, origin: str | None) -> None:
    """Write shmgen.toml for the packages in the current folder.

    The command asks no questions and changes no existing file.
    """
    import shlex

    from shmgen.cli import init

    requirement = (origin or init.requirement()) if ci else ""
    if requirement is None:
        reason = "--ci: this shmgen was installed from a folder, which a CI machine does not have"
        raise click.UsageError(
            f"{reason}; add --from and the package that pip installs in CI, such as 'shmgen[idl] @ git+https://HOST/shmgen'"
        )
    configuration, advice = init.propose(Path.cwd())
    files = {"shmgen.toml": configuration} if configuration else {}
    files |= {init.HOOK_FILE: init.HOOK} if hook else {}
    files |= {init.CI_FILE: init.CI.format(requirement=shlex.quote(requirement))} if ci else {}
    for path, text in files.items():
        file = Path(path)
        if os.path.lexists(file):
            click.echo(f"{path} exists already, and was not changed; this would be its content:\n\n{text}")
        else:
            try:
                for parent in (file.parent, *file.parent.parents):
                    if parent.is_symlink():
                        raise OSError(errno.ELOOP, f"{parent} is a symbolic link")
                file.parent.mkdir(parents=True, exist_ok=True)
                file.write_bytes(text.encode())  # bytes, so that line ends are the same on every system
            except OSError as error:
                raise Rejected([Diagnostic("SHM007", f"cannot write: {error.strerror}", Span(path))]) from error
            click.echo(f"{path} written")
    click.echo("\n".join(advice))
    if hook:
        click.echo("  pre-commit install    once in each clone; `pipx install pre-commit` installs the command")


COMMANDS = (check, diff, init)


def _tell(findings: Sequence[Finding], form: str, fail_on: Severity, *, to_stderr: bool) -> None:
    if form == "json":
        click.echo(as_json(findings), nl=False)
    elif form == "github":
        click.echo(as_annotations(findings, fail_on), nl=False)
    else:
        findings = for_people(findings)
        for finding in findings:
            level = finding.diagnostic.level if finding.severity >= fail_on else "note"
            options.print_diagnostics([finding.diagnostic._replace(level=level)], to_stderr=to_stderr)
        click.echo(summary(findings) or "no difference", err=to_stderr)
