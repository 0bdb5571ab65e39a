"""Extract the C code that blocks need from the output of the target c: the protocol, and the code for each message."""

from __future__ import annotations

from collections.abc import Mapping
from typing import NamedTuple

from shmgen.core.model import TypeName
from shmgen.targets import Job
from shmgen.targets.c.ends import RUNTIME, region_settings
from shmgen.targets.c.target import piece


class Code(NamedTuple):
    """C code without its include lines. The code compiles as C99, C++11 and C++17.

    * `includes`: names of system headers, such as `fcntl.h`.
    * `protocol`: the code that all messages share: the shared-memory protocol, and its use in function blocks.
    * `messages`: the code of each message: its structure with asserted offsets, and the checks of counts and strings.
    """

    includes: tuple[str, ...]
    protocol: tuple[str, ...]
    messages: Mapping[TypeName, tuple[str, ...]]


def code(job: Job) -> Code:
    texts = {one.output.path: one.text for one in job.rendered["c"]}
    regions = job.options.regions
    group_line = [f"#define SHMGEN_GROUP {region_settings(regions).group}"] if regions.group else []
    headers = ("shmgen.h", *(f"shmgen_{name}.h" for name in RUNTIME))
    lines = [line for header in headers for line in texts[f"c/{job.package}/{header}"].splitlines()]
    includes = {line.split()[1].strip("<>") for line in lines if line.startswith("#include <")}
    protocol = (*group_line, *(line for line in lines if not line.startswith("#include")))
    messages = {name: tuple(texts[piece(name)].splitlines()) for name in job.layouts}
    return Code(tuple(sorted(includes)), protocol, messages)
