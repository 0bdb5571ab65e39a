"""Turns /proc into who maps which file of /dev/shm, and what kind of process that is."""

from __future__ import annotations

import os
import re
from collections.abc import Iterator
from contextlib import suppress
from dataclasses import dataclass

from shmgen.live.regions import FOLDER
from shmgen.runtime import header as h


@dataclass(frozen=True, slots=True)
class Mapping:
    """Process `pid` maps the file `name` of a /dev/shm: ours, or one of a container, as `device` tells.

    `removed`: the file has been deleted since. `addresses` names the stretch of memory as in /proc/PID/map_files.
    """

    pid: int
    name: str
    device: int
    inode: int
    removed: bool
    addresses: str

    @property
    def semaphore(self) -> bool:
        return self.name.startswith("sem.")

    def is_region(self) -> bool | None:
        """Whether the file begins with our magic; None if this user may not look."""
        places = [f"/proc/{self.pid}/map_files/{self.addresses}"]
        if not self.removed:
            places.append(f"/proc/{self.pid}/root{FOLDER}/{self.name}")
        for place in places:
            try:
                with open(place, "rb") as file:
                    return int.from_bytes(file.read(4), "little") == h.MAGIC
            except OSError:
                continue
        return None


@dataclass(frozen=True, slots=True)
class Processes:
    """All mappings of files in a /dev/shm at one instant; `hidden` processes could not be looked into."""

    mappings: tuple[Mapping, ...]
    hidden: int


def look() -> Processes:
    """Every process this user may look into."""
    mappings: dict[tuple[int, int, int], Mapping] = {}
    hidden = 0
    for pid in _pids():
        try:
            for found in _mapped(pid):
                mappings.setdefault((found.pid, found.device, found.inode), found)
        except PermissionError:
            hidden += 1
        except OSError:  # it ended meanwhile
            continue
    return Processes(tuple(mappings.values()), hidden)


def has_open(status: os.stat_result) -> bool:
    """Whether a process this user may look into has a descriptor of the file."""
    wanted = (status.st_dev, status.st_ino)
    for pid in _pids():
        with suppress(OSError):
            for descriptor in os.listdir(f"/proc/{pid}/fd"):
                with suppress(OSError):
                    found = os.stat(f"/proc/{pid}/fd/{descriptor}")
                    if (found.st_dev, found.st_ino) == wanted:
                        return True
    return False


def alive(pid: int) -> bool:
    """Whether the process runs; a zombie does not."""
    try:
        with open(f"/proc/{pid}/stat", encoding="utf-8", errors="replace") as file:
            return file.read().rpartition(")")[2].split()[0] not in ("Z", "X")
    except OSError:
        return False


def called(pid: int) -> str:
    """`talker.py`, with its arguments, shortened; nothing if it is gone. Of a script the interpreter goes unnamed."""
    try:
        with open(f"/proc/{pid}/cmdline", "rb") as file:
            words = file.read().decode(errors="replace").split("\0")
    except OSError:
        return ""
    if len(words) > 2 and os.path.basename(words[0]).startswith("python") and not words[1].startswith("-"):
        del words[0]
    line = " ".join([os.path.basename(words[0]), *(word for word in words[1:] if word)])
    line = "".join(sign if sign.isprintable() else " " for sign in line)
    return line if len(line) <= 40 else line[:37] + "..."


def bits(pid: int) -> int | None:
    """32 or 64: the ELF class of its program; None if this user may not look."""
    try:
        with open(f"/proc/{pid}/exe", "rb") as file:
            return {1: 32, 2: 64}.get(file.read(5)[-1])
    except (OSError, IndexError):
        return None


_LINE = re.compile(r"([0-9a-f]+)-([0-9a-f]+) \S+ \S+ ([0-9a-f]+):([0-9a-f]+) (\d+) +/dev/shm/(.+?)( \(deleted\))?\n?")


def _mapped(pid: int) -> Iterator[Mapping]:
    with open(f"/proc/{pid}/maps", encoding="utf-8", errors="replace") as file:
        for line in file:
            if found := _LINE.fullmatch(line):
                start, end, major, minor, inode, name, removed = found.groups()
                yield Mapping(
                    pid,
                    name,
                    os.makedev(int(major, 16), int(minor, 16)),
                    int(inode),
                    bool(removed),
                    f"{int(start, 16):x}-{int(end, 16):x}",
                )


def _pids() -> list[int]:
    return sorted(int(name) for name in os.listdir("/proc") if name.isdigit())
