"""Compare the files that `generate` would write with the existing files, without changing any file."""

from __future__ import annotations

import difflib
from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path

from shmgen.core import write
from shmgen.core.diagnostics import Diagnostic, Rejected, Span
from shmgen.drift import lockfile
from shmgen.drift.compare import compare
from shmgen.drift.findings import Finding, Severity, worst

REGENERATE = "run `shmgen generate` and commit the result"
DELETE = "shmgen removes only files that layout.lock lists: delete this file, or move it to another folder"
_NOT_IN_LOCK = ("is not in layout.lock", "are not in layout.lock")
REBUILD = "run `shmgen generate`, commit the result, rebuild both sides"


def check(texts: Mapping[str, str], folder: Path, target_folders: Sequence[str] = ()) -> list[Finding]:
    """Return the differences between `texts`, the files that `generate` would write, and the files in `folder`.

    `target_folders` are the folders of targets, which are also searched for files that layout.lock does not list.
    """
    place = str(folder / lockfile.LOCK)
    existing = write.current(folder, lockfile.LOCK)
    if existing is None:
        hint = f"{REGENERATE}; if the output is in another folder than {folder}, give that folder with -o"
        diagnostic = Diagnostic("SHM407", "layout.lock is missing", Span(place), hint=hint)
        return [Finding(Severity.BREAKING, diagnostic)]
    is_up_to_date = all(write.current(folder, path) == text.encode() for path, text in texts.items())
    listed = write.names_in(folder, [*texts, *(f"{target_folder}/" for target_folder in target_folders)])
    if is_up_to_date and not write.temporary_files(folder, listed) and not write.unlisted(folder, texts, listed):
        return []  # layout.lock is equal too, and parsing it is slow
    try:
        old = lockfile.read(existing.decode(errors="replace"), place)
    except Rejected as damaged:
        return [Finding(Severity.BREAKING, diagnostic) for diagnostic in damaged.diagnostics]
    new = lockfile.read(texts[lockfile.LOCK], place)
    findings = [_with_advice(diagnostic) for diagnostic in compare(old, new, place)] if old != new else []
    findings += _of_files(texts, folder, old, worst(findings))
    strays = write.unlisted(folder, {*texts, *old.files}, listed)
    findings += _findings_about("SHM406", Severity.COSMETIC, strays, folder, _NOT_IN_LOCK, DELETE)
    if not findings and existing != texts[lockfile.LOCK].encode():
        findings += _findings_about("SHM403", Severity.COSMETIC, [lockfile.LOCK], folder, ("is stale", ""), REGENERATE)
    return findings


def differences(texts: Mapping[str, str], folder: Path) -> str:
    """Return a unified diff from the files in `folder` to `texts`."""
    lines: list[str] = []
    for path, text in texts.items():
        existing = write.current(folder, path)
        if existing != text.encode():
            old = (existing or b"").decode(errors="replace").splitlines(keepends=True)
            before = f"a/{folder / path}" if existing is not None else "/dev/null"
            lines += difflib.unified_diff(old, text.splitlines(keepends=True), before, f"b/{folder / path}")
    return "".join(line if line.endswith("\n") else f"{line}\n\\ No newline at end of file\n" for line in lines)


def _with_advice(finding: Finding) -> Finding:
    advice = REBUILD if finding.severity is Severity.BREAKING else REGENERATE
    hint = "; ".join(filter(None, [advice, finding.diagnostic.hint]))
    return replace(finding, diagnostic=finding.diagnostic._replace(hint=hint))


def _of_files(texts: Mapping[str, str], folder: Path, lock: lockfile.Lock, cause: Severity | None) -> list[Finding]:
    """Return the findings about generated files that are stale, edited, missing or left over.

    A file that already has the new text is not reported, even if layout.lock has the hash of an older text: `generate`
    may have been interrupted.
    """
    stale, edited, missing = [], [], []
    for path, text in texts.items():
        existing, known = write.current(folder, path), lock.files.get(path)
        if path == lockfile.LOCK or existing == text.encode():
            continue
        if existing is None and known:
            missing.append(path)
        elif existing is None or known in (None, lockfile.sha256(existing)):
            stale.append(path)
        else:
            edited.append(path)
    left_over = [path for path in lock.files if path not in texts and write.is_inside(folder, path)]
    left_over += write.temporary_files(folder, write.names_in(folder, [*texts, *lock.files]))
    advice = "" if cause else f"another version of shmgen wrote these files; {REGENERATE}"
    by_hand = "the next `shmgen generate` overwrites the edit: change the definition or shmgen.toml instead"
    return [
        *_findings_about("SHM403", cause or Severity.COSMETIC, stale, folder, ("is stale", "are stale"), advice),
        *_findings_about("SHM404", Severity.BREAKING, edited, folder, ("was edited", "were edited"), by_hand),
        *_findings_about("SHM405", Severity.BREAKING, missing, folder, ("is missing", "are missing"), REGENERATE),
        *_findings_about("SHM406", Severity.COSMETIC, left_over, folder, ("is left over", "are left over"), REGENERATE),
    ]


def _findings_about(
    code: str, severity: Severity, paths: Sequence[str], folder: Path, what: tuple[str, str], hint: str
) -> list[Finding]:
    """Return one finding about all generated files in `paths`, or no finding if `paths` is empty.

    `what` is the fault, in singular and plural: "is stale" and "are stale". A finding about a single file points at
    this file. A finding about several files points at the folder.
    """
    if not paths:
        return []
    if len(paths) == 1:
        diagnostic = Diagnostic(code, f"generated file {what[0]}", Span(str(folder / paths[0])), hint=hint)
    else:
        message = f"{len(paths)} generated files {what[1]}"
        diagnostic = Diagnostic(code, message, Span(str(folder)), hint=hint, details=tuple(sorted(paths)))
    return [Finding(severity, diagnostic, files=tuple(str(folder / path) for path in sorted(paths)))]
