"""Takes from the target c what a block needs: the protocol once, and the pieces of each message."""

from __future__ import annotations

from collections.abc import Mapping
from typing import NamedTuple

from shmgen.core.model import Layout
from shmgen.targets import Job
from shmgen.targets.c.ends import RUNTIME, group
from shmgen.targets.c.target import fits_piece, struct_piece


class Text(NamedTuple):
    """Lines without includes; `includes` are those of the system, `<fcntl.h>` as `fcntl.h`."""

    includes: tuple[str, ...]
    lines: tuple[str, ...]


def printed(job: Job) -> dict[str, str]:
    """By path, what the target c has printed."""
    return {one.output.path: one.text for one in job.printed["c"]}


def protocol(job: Job, texts: Mapping[str, str]) -> Text:
    """What all messages share, and the end of a block: all of it C99, C++11 and C++17."""
    asked = [f"#define SHMGEN_GROUP {group(job.options.regions)}"] if job.options.regions.group else []
    headers = ("shmgen.h", *(f"shmgen_{name}.h" for name in RUNTIME))
    lines = [line for header in headers for line in texts[f"c/{job.package}/{header}"].splitlines()]
    includes = [line.split()[1] for line in lines if line.startswith("#include <")]
    return Text(
        tuple(sorted({include.strip("<>") for include in includes})),
        (*asked, *(line for line in lines if not line.startswith("#include"))),
    )


def message(layout: Layout, texts: Mapping[str, str]) -> tuple[str, ...]:
    """The structure, with its offsets asserted, and the functions that look at its counts and texts."""
    return tuple("\n".join(texts[piece(layout.name)] for piece in (struct_piece, fits_piece)).splitlines())
