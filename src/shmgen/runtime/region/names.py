"""The names of the region of a topic, and of the regions of a service or action."""

from __future__ import annotations

from shmgen.core.abi import EVENT

HALVES = ("request", "response", "goal", "feedback", "result")
"""The suffixes behind the `-` in the region names of a service or action."""
TAKEN = ("CME", "GWDRVSHAREDMEMSHM", "RETAINMEMORY")
"""File names in /dev/shm, in capitals, that the CODESYS runtime and its gateway use."""
_LONGEST = 255 - len("sem." + EVENT)
"""Maximum length of a name: NAME_MAX (255) less `sem.` before and `-event` after the name."""


def region_name(topic: str) -> str:
    """Return the name of the region of a topic, and of its semaphore.

    `/robot/pose` becomes `robot.pose`, and `/cell/start-request` becomes `cell.start-request`. The leading slash is
    optional. A topic is a full ROS name: letters, digits and `_` between slashes, without a digit first. The suffix of
    a part of a service or action may follow, such as `-request` (see HALVES).

    Raises ValueError, with the reason, if the name is invalid.
    """
    full, dash, half = topic.removeprefix("/").partition("-")
    parts = full.split("/")
    name = ".".join(parts) + dash + half
    if topic.startswith("~"):
        raise ValueError(f"topic {topic!r}: replace `~` by the name of the node")
    if not all(parts):
        raise ValueError(f"topic {topic!r}: a part between slashes is empty; write a topic such as `/cell/pose`")
    for part in parts:
        if not (part.isascii() and part.isidentifier()):
            why = "starts with a digit" if part[0].isdigit() else "has invalid characters"
            raise ValueError(f"topic {topic!r}: {part!r} {why}; use letters, digits and `_`")
    if dash and half not in HALVES:
        raise ValueError(f"topic {topic!r}: only {', '.join(HALVES)} may follow a `-`; write `/cell/pose`")
    if parts[0] == "sem" and len(parts) > 1:
        raise ValueError(f"topic {topic!r}: files /dev/shm/sem.* are semaphores; choose another first part than `sem`")
    if parts[0].upper() in TAKEN and len(parts) == 1:
        raise ValueError(f"topic {topic!r}: CODESYS reserves /dev/shm/{parts[0]}*; choose another name")
    if len(name) > _LONGEST:
        raise ValueError(f"topic {topic!r}: the name has {len(name)} characters; the limit is {_LONGEST}")
    return name


def event_name(name: str) -> str:
    """Return the name of the semaphore that wakes waiting readers. No region has such a name."""
    return name + EVENT


def region_file(name: str) -> str:
    """Return the path of the region in the file system of Linux."""
    return f"/dev/shm/{name}"


def semaphore_file(name: str) -> str:
    """Return the path at which glibc stores the semaphore."""
    return f"/dev/shm/sem.{name}"
