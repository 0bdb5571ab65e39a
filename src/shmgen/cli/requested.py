"""The messages that the user requests, now or in an earlier run.

Diagnostics point to the line of shmgen.toml or layout.lock that requests a message.
"""

from __future__ import annotations

import sys
from collections.abc import Iterable, Iterator, Mapping
from pathlib import Path

from shmgen.cli import check_cache
from shmgen.config import Config, document
from shmgen.core.diagnostics import Diagnostic, Rejected, Span
from shmgen.definitions import Library
from shmgen.drift import lockfile
from shmgen.generator import pipeline


def configured(config: Config) -> list[str]:
    """Return the requests of shmgen.toml: its `messages`, and the types of its topics, services and actions."""
    return [*config.messages, *config.types_used]


def read_lock(output: Path, lock_bytes: bytes | None) -> tuple[lockfile.Lock, dict[str, Span]]:
    """Parse the layout.lock of an earlier run, without its messages. Return its content, and the line of each request.

    `lock_bytes` is the content of layout.lock, or None if the file is missing; the result is then empty. Raises
    Rejected if the file is damaged (SHM408).
    """
    if lock_bytes is None:
        return lockfile.Lock(), {}
    text, place = lock_bytes.decode(errors="replace"), str(output / lockfile.LOCK)
    lock = lockfile.read_requested(text, place)
    return lock, document.quoted(text, place, lock.requested)


def texts(
    config: Config, requests: Iterable[str], earlier: Mapping[str, Span], output: Path, opened: Library | None = None
) -> dict[str, str]:
    """Generate the requested messages. Return the text of each generated file by path.

    `earlier` contains the requests of an earlier run, and `output` is the folder of its layout.lock. `opened` is the
    library of definitions, if the caller has one. Raises Rejected if there is no request, or if one has an error. Each
    diagnostic points at the request with the error, in shmgen.toml or in the layout.lock of an earlier run.
    """
    requests = dict.fromkeys(requests)
    if not requests:
        hint = 'name one, `shmgen generate geometry_msgs/Pose`, or list them in shmgen.toml: messages = ["..."]'
        raise Rejected([Diagnostic("SHM504", "no messages to generate", Span("command line"), hint=hint)])
    try:
        return pipeline.generate(config, requests, opened)
    except Rejected as rejected:
        diagnostics = [_at_request(diagnostic, config.places, earlier, output) for diagnostic in rejected.diagnostics]
        if {diagnostic.code for diagnostic in diagnostics} == {"SHM101"}:
            for_all = "one bound for all sequences: default = N under [bounds] in shmgen.toml"
            hints = [diagnostics[-1].hint, *([for_all] if diagnostics[1:] else []), *_skip_hint(config, requests)]
            diagnostics[-1] = diagnostics[-1]._replace(hint="\n".join(hints))
        raise Rejected(diagnostics) from rejected


def remember(
    output: str, config: Config, requests: Iterable[str], config_file: Path | None, files: Iterable[str], began: int
) -> None:
    """Store in the cache that this command printed `output`, if the command had nothing to do.

    `files` are the paths of the generated files, and `began` is that of check_cache.store(). Nothing is stored if a
    definition is requested by path or comes from a sourced ROS, because the cache cannot watch its file.
    """
    anywhere = config.source == "env" or any(Path(request).suffix for request in requests)
    if not anywhere:
        configurations = [str(config_file)] if config_file else ["shmgen.toml", "pyproject.toml"]
        read = [*configurations, *map(str, config.sources), *files]
        check_cache.store(sys.argv[1:], output, map(str, config.path), read, began)


def _skip_hint(config: Config, requests: Iterable[str]) -> Iterator[str]:
    """Yield a hint to use --skip-unbounded, if only some messages of a requested package lack bounds."""
    if all("/" in request or Path(request).suffix for request in requests):
        return
    usable, omitted = pipeline.skippable(config, requests)
    if omitted:
        could = f"{len(usable)} of {len(usable) + len(omitted)} requested messages need no more bounds"
        yield f"{could}: `shmgen generate` with --skip-unbounded leaves out the others"


def _at_request(
    diagnostic: Diagnostic, written: Mapping[str, Span], earlier: Mapping[str, Span], output: Path
) -> Diagnostic:
    request = diagnostic.span.path
    if request in written:
        return diagnostic._replace(span=written[request])
    if request in earlier:
        hint = f"an earlier run requested this: give its folder or file again, or delete {output}/ and generate again"
        return diagnostic._replace(span=earlier[request], hint=f"{diagnostic.hint}\n{hint}")
    return diagnostic
