"""What is wrong with a region or with the machine, which file and which process it is, and what to do next."""

from __future__ import annotations

import os
from dataclasses import dataclass

from shmgen.runtime.region.access import name_of_group, name_of_user


@dataclass(frozen=True, slots=True)
class Problem:
    """`file` and `process` (a pid) are None where none is at fault. A note is no fault, only good to know."""

    topic: str
    message: str
    hint: str
    file: str | None = None
    process: int | None = None
    note: bool = False


def owner(status: os.stat_result) -> str:
    """`root:robot, mode 660`."""
    return f"{name_of_user(status.st_uid)}:{name_of_group(status.st_gid)}, mode {status.st_mode & 0o7777:o}"
