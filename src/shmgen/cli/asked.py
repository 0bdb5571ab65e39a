"""Turns what the user asks for, now or in a former run, into texts; complaints go to where it was written."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import replace
from pathlib import Path

from shmgen import pipeline
from shmgen.config import Config, document
from shmgen.diagnostics import Diagnostic, Rejected, Report, Span
from shmgen.drift import lockfile


def configured(config: Config) -> list[str]:
    """What shmgen.toml lists."""
    return [*config.messages, *config.types_used]


def former(output: Path, kept: bytes | None) -> tuple[lockfile.Lock, dict[str, Span]]:
    """What a former run left in the folder, and where each of its requests stands there. Raises Rejected: SHM408.

    `kept` are the bytes of layout.lock there, None if there is none.
    """
    if kept is None:
        return lockfile.Lock(), {}
    file, report = output / lockfile.LOCK, Report()
    text = kept.decode(errors="replace")
    lock = lockfile.read(text, str(file), report)
    report.stop_if_any()
    return lock, document.quoted(text, str(file), lock.requested)


def texts(config: Config, requests: Iterable[str], formerly: Mapping[str, Span], output: Path) -> dict[str, str]:
    """{path: text} of all targets. What is wrong with a request is told at the place where it was written."""
    requests = dict.fromkeys(requests)
    if not requests:
        hint = 'name one, `shmgen generate geometry_msgs/Pose`, or list them in shmgen.toml: messages = ["..."]'
        raise Rejected([Diagnostic("SHM504", "no messages to generate", Span("command line"), hint=hint)])
    try:
        return pipeline.generate(config, requests)
    except Rejected as rejected:
        raise Rejected(_placed(found, config.places, formerly, output) for found in rejected.diagnostics) from rejected


def _placed(found: Diagnostic, written: Mapping[str, Span], formerly: Mapping[str, Span], output: Path) -> Diagnostic:
    request = found.span.path
    if request in written:
        return replace(found, span=written[request])
    if request in formerly:
        hint = f"a former run was asked for it: say again where it is, or delete {output}/ to start afresh"
        return replace(found, span=formerly[request], hint=f"{found.hint}\n{hint}")
    return found
