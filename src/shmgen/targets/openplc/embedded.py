"""Extract the C code that blocks need from the output of the target c: the protocol, and the code for each message."""

from __future__ import annotations

from collections.abc import Mapping
from typing import NamedTuple

from shmgen.core.model import Layout
from shmgen.targets import Job
from shmgen.targets.c.ends import RUNTIME, group
from shmgen.targets.c.target import fits_piece, struct_piece


class Text(NamedTuple):
    """C code without its include lines. `includes` are names of system headers, such as `fcntl.h`."""

    includes: tuple[str, ...]
    lines: tuple[str, ...]


def rendered_files(job: Job) -> dict[str, str]:
    """Return the content of all files of the target c, by path."""
    return {one.output.path: one.text for one in job.rendered["c"]}


def protocol(job: Job, texts: Mapping[str, str]) -> Text:
    """Return the C code that all messages share: the shared-memory protocol, and its use in function blocks.

    A function block contains a publisher, a subscriber, or both for a service or an action. `texts` are the files of
    the target c by path.

    The code compiles as C99, C++11 and C++17.
    """
    group_line = [f"#define SHMGEN_GROUP {group(job.options.regions)}"] if job.options.regions.group else []
    headers = ("shmgen.h", *(f"shmgen_{name}.h" for name in RUNTIME))
    lines = [line for header in headers for line in texts[f"c/{job.package}/{header}"].splitlines()]
    includes = [line.split()[1] for line in lines if line.startswith("#include <")]
    return Text(
        tuple(sorted({include.strip("<>") for include in includes})),
        (*group_line, *(line for line in lines if not line.startswith("#include"))),
    )


def message(layout: Layout, texts: Mapping[str, str]) -> tuple[str, ...]:
    """Return the C lines for one message: its structure with asserted offsets, and the checks of counts and strings."""
    return tuple("\n".join(texts[piece(layout.name)] for piece in (struct_piece, fits_piece)).splitlines())
