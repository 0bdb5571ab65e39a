"""Compares what would be generated with what lies in the folder; changes nothing."""

from __future__ import annotations

import difflib
from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path

from shmgen.core import write
from shmgen.core.diagnostics import Diagnostic, Report, Span
from shmgen.drift import lockfile
from shmgen.drift.compare import compare
from shmgen.drift.findings import Finding, Severity, worst

REGENERATE = "run `shmgen generate` and commit the result"
REBUILD = "run `shmgen generate`, commit the result, rebuild both sides"


def check(texts: Mapping[str, str], folder: Path) -> list[Finding]:
    """`texts` is all that `generate` would write into `folder`, layout.lock among it."""
    shown = str(folder / lockfile.LOCK)
    kept = write.current(folder, lockfile.LOCK)
    if kept is None:
        hint = f"{REGENERATE}; if {folder} is not where it was written, give that with -o"
        found = Diagnostic("SHM407", "layout.lock is missing", Span(shown), hint=hint)
        return [Finding(Severity.BREAKING, found)]
    as_it_should_be = all(write.current(folder, path) == text.encode() for path, text in texts.items())
    if as_it_should_be and not write.abandoned(folder, write.names_in(folder, texts)):
        return []  # layout.lock among them, which is slow to take apart
    report = Report()
    old = lockfile.read(kept.decode(errors="replace"), shown, report)
    if report.diagnostics:
        return [Finding(Severity.BREAKING, found) for found in report.diagnostics]
    new = lockfile.read(texts[lockfile.LOCK], shown, report)
    findings = [_with_advice(found) for found in compare(old, new, shown)] if old != new else []
    findings += _of_files(texts, folder, old, worst(findings))
    if not findings and kept != texts[lockfile.LOCK].encode():
        findings += _listed("SHM403", Severity.COSMETIC, [lockfile.LOCK], folder, ("is stale", ""), REGENERATE)
    return findings


def differences(texts: Mapping[str, str], folder: Path) -> str:
    """A unified diff from the files in `folder` to `texts`."""
    lines: list[str] = []
    for path, text in texts.items():
        kept = write.current(folder, path)
        if kept != text.encode():
            old = (kept or b"").decode(errors="replace").splitlines(keepends=True)
            before = f"a/{folder / path}" if kept is not None else "/dev/null"
            lines += difflib.unified_diff(old, text.splitlines(keepends=True), before, f"b/{folder / path}")
    return "".join(line if line.endswith("\n") else f"{line}\n\\ No newline at end of file\n" for line in lines)


def _with_advice(found: Finding) -> Finding:
    advice = REBUILD if found.severity is Severity.BREAKING else REGENERATE
    hint = "; ".join(filter(None, [advice, found.diagnostic.hint]))
    return replace(found, diagnostic=replace(found.diagnostic, hint=hint))


def _of_files(texts: Mapping[str, str], folder: Path, lock: lockfile.Lock, cause: Severity | None) -> list[Finding]:
    """An interrupted `generate` leaves files that are new already: those are as they should be."""
    stale, edited, missing = [], [], []
    for path, text in texts.items():
        kept, known = write.current(folder, path), lock.files.get(path)
        if path == lockfile.LOCK or kept == text.encode():
            continue
        if kept is None and known:
            missing.append(path)
        elif kept is None or known in (None, lockfile.sha256(kept)):
            stale.append(path)
        else:
            edited.append(path)
    left_over = [path for path in lock.files if path not in texts and write.is_inside(folder, path)]
    left_over += write.abandoned(folder, write.names_in(folder, [*texts, *lock.files]))
    advice = "" if cause else f"another version of shmgen wrote this; {REGENERATE}"
    by_hand = "it is lost at the next `shmgen generate`: change the definition or shmgen.toml instead"
    return [
        *_listed("SHM403", cause or Severity.COSMETIC, stale, folder, ("is stale", "are stale"), advice),
        *_listed("SHM404", Severity.BREAKING, edited, folder, ("was edited", "were edited"), by_hand),
        *_listed("SHM405", Severity.BREAKING, missing, folder, ("is missing", "are missing"), REGENERATE),
        *_listed("SHM406", Severity.COSMETIC, left_over, folder, ("is left over", "are left over"), REGENERATE),
    ]


def _listed(
    code: str, severity: Severity, paths: Sequence[str], folder: Path, what: tuple[str, str], hint: str
) -> list[Finding]:
    """One finding for all of them, called by its file where it is one."""
    if not paths:
        return []
    if len(paths) == 1:
        found = Diagnostic(code, f"generated file {what[0]}", Span(str(folder / paths[0])), hint=hint)
    else:
        message = f"{len(paths)} generated files {what[1]}"
        found = Diagnostic(code, message, Span(str(folder)), hint=hint, details=tuple(sorted(paths)))
    return [Finding(severity, found, files=tuple(str(folder / path) for path in sorted(paths)))]
