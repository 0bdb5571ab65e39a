"""A problem of a region or of the machine, with the file, the process and the next step."""

from __future__ import annotations

import os
from dataclasses import dataclass

from shmgen.runtime.region.access import name_of_group, name_of_user


@dataclass(frozen=True, slots=True)
class Problem:
    """A finding about a region or the machine, with the next step as its `hint`.

    If `note` is true, the finding is information, not a fault. `file` is the path of the faulty file, and `process` the
    pid of the faulty process. None means that no single file or process is faulty.
    """

    topic: str
    message: str
    hint: str
    file: str | None = None
    process: int | None = None
    note: bool = False


def owner(status: os.stat_result) -> str:
    """Return owner, group and mode as text, such as `root:robot, mode 660`."""
    return f"{name_of_user(status.st_uid)}:{name_of_group(status.st_gid)}, mode {status.st_mode & 0o7777:o}"
