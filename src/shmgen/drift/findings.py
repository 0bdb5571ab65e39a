"""Findings of `check` and `diff` for machines: JSON, and annotations of GitHub."""

from __future__ import annotations

import json
from collections.abc import Iterable, Sequence
from enum import IntEnum

from shmgen.core.diagnostics import Diagnostic
from shmgen.core.fast_dataclass import dataclass


class Severity(IntEnum):
    """What a difference does to programs already built."""

    COSMETIC = 1
    """Text of generated files that no program sees."""
    COMPATIBLE = 2
    """Comments, constants, defaults, new messages: old and new programs still talk."""
    BREAKING = 3
    """Bytes moved or got another meaning, or nobody can tell that they did not."""


@dataclass(frozen=True, slots=True)
class Change:
    """One line of a finding. `kinds` such as moved and count; offsets in bytes from the start of the message."""

    field: str
    kinds: tuple[str, ...]
    text: str
    old_offset: int | None = None
    new_offset: int | None = None


@dataclass(frozen=True, slots=True)
class Finding:
    """`origin` is the definition it is about, for an annotation; `files` those that are stale, edited and so on."""

    severity: Severity
    diagnostic: Diagnostic
    changes: tuple[Change, ...] = ()
    origin: str = ""
    files: tuple[str, ...] = ()


def worst(findings: Iterable[Finding]) -> Severity | None:
    return max((found.severity for found in findings), default=None)


def summary(findings: Sequence[Finding]) -> str:
    """`2 breaking, 1 cosmetic`."""
    counts = [(sum(found.severity is severity for found in findings), severity) for severity in reversed(Severity)]
    return ", ".join(f"{count} {severity.name.lower()}" for count, severity in counts if count)


def as_json(findings: Sequence[Finding]) -> str:
    """A stable shape: `worst` (null if nothing was found) and `findings`, each with its `changes` and `files`."""
    most = worst(findings)
    data = {
        "worst": most.name.lower() if most else None,
        "findings": [
            {
                "code": found.diagnostic.code,
                "severity": found.severity.name.lower(),
                "file": found.diagnostic.span.path,
                "line": found.diagnostic.span.line or None,
                "origin": found.origin or None,
                "message": found.diagnostic.message,
                "hint": found.diagnostic.hint,
                "changes": [
                    {
                        "field": change.field,
                        "kinds": list(change.kinds),
                        "text": change.text,
                        "old_offset": change.old_offset,
                        "new_offset": change.new_offset,
                    }
                    for change in found.changes
                ],
                "files": list(found.files),
            }
            for found in findings
        ],
    }
    return json.dumps(data, indent=2, ensure_ascii=False) + "\n"


def as_annotations(findings: Iterable[Finding], fail_on: Severity) -> str:
    """Workflow commands of GitHub Actions: ::error file=…,line=…,title=…::…"""
    lines = []
    for found in findings:
        diagnostic = found.diagnostic
        level = "error" if found.severity >= fail_on else "notice"
        places = {"file": found.origin or diagnostic.span.path, "title": f"{diagnostic.code} {diagnostic.message}"}
        if diagnostic.span.line and not found.origin:
            places |= {"line": str(diagnostic.span.line), "col": str(diagnostic.span.column or 1)}
        body = "\n".join(filter(None, [*diagnostic.details, diagnostic.field, diagnostic.hint]))
        where = ",".join(f"{key}={_property(value)}" for key, value in places.items())
        lines.append(f"::{level} {where}::{_data(body or diagnostic.message)}\n")
    return "".join(lines)


def _data(text: str) -> str:
    """Escapes of @actions/core, command.ts."""
    return text.replace("%", "%25").replace("\r", "%0D").replace("\n", "%0A")


def _property(text: str) -> str:
    return _data(text).replace(":", "%3A").replace(",", "%2C")
