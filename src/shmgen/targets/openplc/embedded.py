"""Cuts what the target c printed down to what a block needs: the protocol once, and of each message its C structure.

Comments go, and so does what C programs alone would call. All of it is C99, C++11 and C++17.
"""

from __future__ import annotations

import re
from collections.abc import Iterable, Iterator
from typing import NamedTuple

from shmgen.core.model import Layout
from shmgen.targets import Job
from shmgen.targets.c.ends import RUNTIME
from shmgen.targets.c.names import ends_header, header, struct_name


class Text(NamedTuple):
    """Lines without own headers; `includes` are those of the system, `<fcntl.h>` as `fcntl.h`."""

    includes: tuple[str, ...]
    lines: tuple[str, ...]


def protocol(job: Job) -> Text:
    """What all messages share, and the end of a block."""
    found = {printed.output.path: printed.text for printed in job.printed["c"]}
    texts = [found[f"c/{job.package}/shmgen.h"]]
    texts += [found[f"c/{job.package}/shmgen_{name}.h"] for name in RUNTIME]
    return _text(texts)


def message(layout: Layout, job: Job) -> tuple[str, ...]:
    """The structure, with its offsets asserted, and the functions that look at its counts and texts."""
    found = {printed.output.path: printed.text for printed in job.printed["c"]}
    paths = (header(layout.name, job.package), ends_header(layout.name, job.package))
    name = struct_name(layout.name)
    foreign = re.compile(rf"shmgen_valid_{name}\b|#define {name}_|\b{name}_(publisher|subscriber)\b")
    return _text([found[f"c/{path}"] for path in paths], foreign).lines


def _text(texts: Iterable[str], foreign: re.Pattern[str] | None = None) -> Text:
    includes: list[str] = []
    lines: list[str] = []
    for text in texts:
        for item in _items(_bare(text)):
            if foreign and foreign.search(item):
                continue
            for line in item.splitlines():
                system = re.fullmatch(r"\s*#include <(.+)>", line)
                if system:
                    includes.append(system[1])
                elif not re.match(r"\s*#include", line):
                    lines.append(line)
    return Text(tuple(sorted(set(includes))), tuple(lines))


_TOKEN = re.compile(r"""/\*.*?\*/|"(?:\\.|[^"\\])*"|'(?:\\.|[^'\\])*'""", re.DOTALL)


def _bare(text: str) -> str:
    """Without comments and empty lines."""
    plain = _TOKEN.sub(lambda found: " " if found[0].startswith("/*") else found[0], text)
    return "\n".join(line.rstrip() for line in plain.splitlines() if line.strip())


def _items(text: str) -> Iterator[str]:
    """Declarations and directives as they stand beside one another; a body goes with its head."""
    item: list[str] = []
    for line in text.splitlines():
        begins = line[:1] not in (" ", "{", "}", ")")
        if begins and item:
            yield "\n".join(item)
            item = []
        item.append(line)
    if item:
        yield "\n".join(item)
