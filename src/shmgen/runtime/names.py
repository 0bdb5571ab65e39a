"""Turns a topic into the name of its region."""

from __future__ import annotations

_LONGEST = 245
"""NAME_MAX (255) less `sem.` before and `-event` after the name."""


def region_name(topic: str) -> str:
    """`/robot/pose` -> `robot.pose`: the shared memory object and the semaphore of the topic.

    The leading slash may be left out. Raises ValueError, with the reason, for anything that is not a
    full ROS name (letters, digits and `_` between slashes, no digit first).
    """
    parts = topic.removeprefix("/").split("/")
    name = ".".join(parts)
    if topic.startswith("~"):
        raise ValueError(f"topic {topic!r}: `~` stands for a node's name; write the name out")
    if not all(parts):
        raise ValueError(f"topic {topic!r}: nothing stands before, between or after the slashes")
    for part in parts:
        if not (part.isascii() and part.isidentifier()):
            raise ValueError(
                f"topic {topic!r}: {part!r} is not made of letters, digits and `_`, starting with no digit"
            )
    if parts[0] == "sem" and len(parts) > 1:
        raise ValueError(f"topic {topic!r}: files /dev/shm/sem.* are semaphores; choose another first part than `sem`")
    if len(name) > _LONGEST:
        raise ValueError(f"topic {topic!r}: {len(name)} characters; a file name leaves room for {_LONGEST}")
    return name


def event_name(name: str) -> str:
    """The semaphore that wakes a waiting reader of the region `name`; a `-` stands in no ROS name."""
    return f"{name}-event"


def region_file(name: str) -> str:
    """Where Linux shows the shared memory object."""
    return f"/dev/shm/{name}"


def semaphore_file(name: str) -> str:
    """Where glibc shows the semaphore."""
    return f"/dev/shm/sem.{name}"
