"""Findings of `check` and `diff`, and their formats: text, JSON, and annotations for GitHub."""

from __future__ import annotations

import json
from collections.abc import Iterable, Sequence
from dataclasses import asdict, dataclass, replace
from enum import IntEnum

from shmgen.core.diagnostics import Diagnostic, Span
from shmgen.core.plural import counted


class Severity(IntEnum):
    """The effect that a difference has on programs which were built before."""

    COSMETIC = 1
    """Only text in generated files differs, without an effect on programs."""
    COMPATIBLE = 2
    """Comments changed, or constants or messages are new. Old and new programs still communicate."""
    BREAKING = 3
    """Bytes moved or changed their meaning, or shmgen cannot exclude such a change."""


@dataclass(frozen=True, slots=True)
class Change:
    """A changed field, constant or setting: one line of a finding. `kinds` are words such as moved and count.

    Offsets are in bytes from the start of the message. The old offset of a new field is None, and the new offset of a
    removed field.
    """

    field: str
    kinds: tuple[str, ...]
    text: str
    old_offset: int | None = None
    new_offset: int | None = None


@dataclass(frozen=True, slots=True)
class Finding:
    """A difference that `check` or `diff` found.

    `check` compares existing files with the files that `generate` would write, and `diff` compares two locks. `name` is
    the changed message, and `origin` its definition. `files` are the files that are stale, edited, missing or left
    over. If the message changed only because it contains edited messages, `causes` are the names of these edited
    messages.
    """

    severity: Severity
    diagnostic: Diagnostic
    changes: tuple[Change, ...] = ()
    origin: str = ""
    files: tuple[str, ...] = ()
    name: str = ""
    causes: tuple[str, ...] = ()


def worst(findings: Iterable[Finding]) -> Severity | None:
    return max((finding.severity for finding in findings), default=None)


def for_people(findings: Sequence[Finding]) -> list[Finding]:
    """Return the findings to print as text: each points at the changed definition.

    If a message changed only because it contains an edited message, its finding is dropped. The finding of the edited
    message then names the containing message.
    """
    return [_with_containers(finding, findings) for finding in findings if not finding.causes]


def _with_containers(finding: Finding, findings: Iterable[Finding]) -> Finding:
    diagnostic = finding.diagnostic._replace(span=Span(finding.origin)) if finding.origin else finding.diagnostic
    if containers := [other.name for other in findings if finding.name in other.causes]:
        contain = "contains" if len(containers) == 1 else "contain"
        line = f"changed too: {counted(len(containers), 'message')} that {contain} it, {', '.join(containers)}"
        diagnostic = diagnostic._replace(details=(*diagnostic.details, line))
    return replace(finding, diagnostic=diagnostic)


def summary(findings: Sequence[Finding]) -> str:
    """Return the number of findings of each severity, such as `2 breaking, 1 cosmetic`."""
    counts = [(sum(finding.severity is severity for finding in findings), severity) for severity in reversed(Severity)]
    return ", ".join(f"{count} {severity.name.lower()}" for count, severity in counts if count)


def as_json(findings: Sequence[Finding]) -> str:
    """Return JSON with a stable structure: `worst` and `findings`, each with its `changes` and `files`.

    `worst` is null if there are no findings.
    """
    most = worst(findings)
    data = {
        "worst": most.name.lower() if most else None,
        "findings": [
            {
                "code": finding.diagnostic.code,
                "severity": finding.severity.name.lower(),
                "file": finding.diagnostic.span.path,
                "line": finding.diagnostic.span.line or None,
                "origin": finding.origin or None,
                "message": finding.diagnostic.message,
                "hint": finding.diagnostic.hint,
                "changes": [asdict(change) for change in finding.changes],
                "files": finding.files,
            }
            for finding in findings
        ],
    }
    return json.dumps(data, indent=2, ensure_ascii=False) + "\n"


def as_annotations(findings: Iterable[Finding], fail_on: Severity) -> str:
    """Return workflow commands of GitHub Actions: `::error file=…,line=…,title=…::…`.

    Findings below `fail_on` are notices.
    """
    lines = []
    for finding in findings:
        diagnostic = finding.diagnostic
        level = "error" if finding.severity >= fail_on else "notice"
        places = {"file": finding.origin or diagnostic.span.path, "title": f"{diagnostic.code} {diagnostic.message}"}
        if diagnostic.span.line and not finding.origin:
            places |= {"line": str(diagnostic.span.line), "col": str(diagnostic.span.column or 1)}
        body = "\n".join(filter(None, [*diagnostic.details, diagnostic.field, diagnostic.hint]))
        where = ",".join(f"{key}={_property(value)}" for key, value in places.items())
        lines.append(f"::{level} {where}::{_data(body or diagnostic.message)}\n")
    return "".join(lines)


def _data(text: str) -> str:
    """Escape a text for a workflow command of GitHub, as command.ts in @actions/core does."""
    return text.replace("%", "%25").replace("\r", "%0D").replace("\n", "%0A")


def _property(text: str) -> str:
    return _data(text).replace(":", "%3A").replace(",", "%2C")
