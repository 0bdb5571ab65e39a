"""The name of the region of a topic, or of a half of a service or action."""

from __future__ import annotations

from shmgen.core.abi import EVENT

HALVES = ("request", "response", "goal", "feedback", "result")
"""What stands behind the `-` in the regions of a service or action."""
TAKEN = ("CME", "GWDRVSHAREDMEMSHM", "RETAINMEMORY")
"""In capitals: what begins the names of files that the CODESYS runtime and its gateway have in /dev/shm."""
_LONGEST = 255 - len("sem." + EVENT)
"""NAME_MAX (255) less `sem.` before and `-event` after the name."""


def region_name(topic: str) -> str:
    """`/robot/pose` -> `robot.pose`, `/cell/start-request` -> `cell.start-request`: the object and its semaphore.

    The leading slash may be left out. Raises ValueError, with the reason, for anything that is not a
    full ROS name (letters, digits and `_` between slashes, no digit first) with one of HALVES behind it or none.
    """
    full, dash, half = topic.removeprefix("/").partition("-")
    parts = full.split("/")
    name = ".".join(parts) + dash + half
    if topic.startswith("~"):
        raise ValueError(f"topic {topic!r}: `~` stands for a node's name; write the name out")
    if not all(parts):
        raise ValueError(f"topic {topic!r}: a part between slashes is empty")
    for part in parts:
        if not (part.isascii() and part.isidentifier()):
            why = "starts with a digit" if part[0].isdigit() else "has other characters"
            raise ValueError(f"topic {topic!r}: {part!r} {why}; use letters, digits and `_`")
    if dash and half not in HALVES:
        raise ValueError(f"topic {topic!r}: a `-` stands only before {', '.join(HALVES)}, in services and actions")
    if parts[0] == "sem" and len(parts) > 1:
        raise ValueError(f"topic {topic!r}: files /dev/shm/sem.* are semaphores; choose another first part than `sem`")
    if parts[0].upper() in TAKEN and len(parts) == 1:
        raise ValueError(f"topic {topic!r}: CODESYS keeps /dev/shm/{parts[0]}* for itself; choose another name")
    if len(name) > _LONGEST:
        raise ValueError(f"topic {topic!r}: {len(name)} characters; a file name leaves room for {_LONGEST}")
    return name


def event_name(name: str) -> str:
    """The semaphore that wakes a waiting reader of the region `name`; no region has such a name."""
    return name + EVENT


def region_file(name: str) -> str:
    """Where Linux shows the shared memory object."""
    return f"/dev/shm/{name}"


def semaphore_file(name: str) -> str:
    """Where glibc shows the semaphore."""
    return f"/dev/shm/sem.{name}"
