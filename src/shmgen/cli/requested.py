"""What the user asks for, now or in a former run; complaints point at where it was written."""

from __future__ import annotations

import sys
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import replace
from pathlib import Path

from shmgen.config import Config, document
from shmgen.core.diagnostics import Diagnostic, Rejected, Report, Span
from shmgen.definitions import Library
from shmgen.drift import check_cache, lockfile
from shmgen.generator import pipeline


def configured(config: Config) -> list[str]:
    """What shmgen.toml lists."""
    return [*config.messages, *config.types_used]


def former(output: Path, kept: bytes | None) -> tuple[lockfile.Lock, dict[str, Span]]:
    """What a former run left in the folder, messages aside, and where each request stands. Raises Rejected: SHM408.

    `kept` are the bytes of layout.lock there, None if there is none.
    """
    if kept is None:
        return lockfile.Lock(), {}
    file, report = output / lockfile.LOCK, Report()
    text = kept.decode(errors="replace")
    lock = lockfile.read_asked(text, str(file), report)
    report.stop_if_any()
    return lock, document.quoted(text, str(file), lock.requested)


def texts(
    config: Config, requests: Iterable[str], formerly: Mapping[str, Span], output: Path, opened: Library | None = None
) -> dict[str, str]:
    """{path: text} of all targets. What is wrong with a request is told at the place where it was written."""
    requests = dict.fromkeys(requests)
    if not requests:
        hint = 'name one, `shmgen generate geometry_msgs/Pose`, or list them in shmgen.toml: messages = ["..."]'
        raise Rejected([Diagnostic("SHM504", "no messages to generate", Span("command line"), hint=hint)])
    try:
        return pipeline.generate(config, requests, opened)
    except Rejected as rejected:
        found = [_placed(found, config.places, formerly, output) for found in rejected.diagnostics]
        if {diagnostic.code for diagnostic in found} == {"SHM101"}:
            found[-1] = replace(found[-1], hint="\n".join([found[-1].hint, *_way_round(config, requests)]))
        raise Rejected(found) from rejected


def left_out(config: Config, requests: Iterable[str]) -> list[str]:
    """What `--skip-unbounded` leaves out, for people."""
    asked, bounded = pipeline.skippable(config, dict.fromkeys([*requests, *config.types_used]))
    return sorted(name.short for name in asked.requested - bounded.requested)


def remember(
    said: str,
    config: Config,
    requests: Iterable[str],
    config_file: Path | None,
    files: Iterable[str],
    began: int,
    written: Mapping[str, str] | None = None,
) -> None:
    """That there was nothing to do, for the next such run; `files` are those written, or that would have been.

    Definitions given by their paths, or of a sourced ROS, may lie anywhere, so then nothing is remembered.
    """
    anywhere = config.source == "env" or any(Path(request).suffix for request in requests)
    if not anywhere:
        configurations = [str(config_file)] if config_file else ["shmgen.toml", "pyproject.toml"]
        read = [*configurations, *map(str, config.sources), *files]
        check_cache.store(sys.argv[1:], said, map(str, config.path), read, began, written)


def _way_round(config: Config, requests: Iterable[str]) -> Iterator[str]:
    """Where some of a package that is asked for could be had."""
    if all("/" in request or Path(request).suffix for request in requests):
        return
    asked, bounded = pipeline.skippable(config, dict.fromkeys([*requests, *config.types_used]))
    if bounded.requested < asked.requested:
        could = f"{len(bounded.requested)} of {len(asked.requested)} messages asked for need no more bounds"
        yield f"{could}: `shmgen generate` with --skip-unbounded leaves out the others"


def _placed(found: Diagnostic, written: Mapping[str, Span], formerly: Mapping[str, Span], output: Path) -> Diagnostic:
    request = found.span.path
    if request in written:
        return replace(found, span=written[request])
    if request in formerly:
        hint = f"a former run was asked for it: say again where it is, or delete {output}/ to start afresh"
        return replace(found, span=formerly[request], hint=f"{found.hint}\n{hint}")
    return found
