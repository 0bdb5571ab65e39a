"""Who maps which file of /dev/shm, and what kind of process that is, out of /proc."""

from __future__ import annotations

import os
import re
from collections.abc import Iterator
from contextlib import suppress
from dataclasses import dataclass

from shmgen.core.escape import legible
from shmgen.live.regions import FOLDER
from shmgen.runtime.region import header as h


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
        for place in self._places():
            with suppress(OSError):
                descriptor = os.open(place, os.O_RDONLY | os.O_CLOEXEC | os.O_NONBLOCK)
                with open(descriptor, "rb", buffering=0) as file:
                    if _file(os.fstat(descriptor)) == (self.device, self.inode):
                        return int.from_bytes(file.read(4), "little") == h.MAGIC
        return None

    def _places(self) -> Iterator[str]:
        """Where the file can be read: root's way; by the process's own descriptor; by its name."""
        yield f"/proc/{self.pid}/map_files/{self.addresses}"
        yield from _descriptors(self.pid, (self.device, self.inode))
        if not self.removed:
            yield f"/proc/{self.pid}/root{FOLDER}/{self.name}"


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
    return any(True for pid in _pids() for _ in _descriptors(pid, (status.st_dev, status.st_ino)))


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
        words = _command(pid)
    except OSError:
        return ""
    while len(words) > 2 and _EMULATOR.fullmatch(words[0]) and not words[1].startswith("-"):
        # The program's file, and behind it its own first word where the kernel was told to keep that.
        kept = words[0].endswith("-P") or os.path.basename(words[1]) == os.path.basename(words[2])
        del words[: 1 + kept]
    if len(words) > 2 and os.path.basename(words[0]).startswith("python") and not words[1].startswith("-"):
        del words[0]
    line = " ".join([os.path.basename(words[0]), *(word for word in words[1:] if word)])
    line = legible(" ".join(line.split()))
    return line if len(line) <= 40 else line[:37] + "..."


def bits(pid: int) -> int | None:
    """32 or 64: the ELF class of its program, or what its emulator stands for; None if this user may not look."""
    try:
        with open(f"/proc/{pid}/exe", "rb") as file:
            found = {1: 32, 2: 64}.get(file.read(5)[-1])
        emulator = _EMULATOR.fullmatch(_command(pid)[0])
    except (OSError, IndexError):
        return None
    if emulator:
        return 64 if "64" in (emulator[1] or emulator[2]) else 32
    return found


_KIND = "aarch64|arm|i386|riscv64|x86_64"
_EMULATOR = re.compile(rf"(?:.*/)?(?:qemu-({_KIND})(?:-static)?|({_KIND})-binfmt-P)")
"""qemu-user, by the names that its makers, docker's images and Debian give it."""


def _command(pid: int) -> list[str]:
    with open(f"/proc/{pid}/cmdline", "rb") as file:
        return file.read().decode(errors="replace").split("\0")


_PATH = r"(?:/.*)?/dev/shm/(.+?)( \(deleted\))?\n?"
"""Seen out of a chroot, the path of what lies outside begins with that of the chroot."""

_LINE = re.compile(r"([0-9a-f]+)-([0-9a-f]+) \S+ \S+ ([0-9a-f]+):([0-9a-f]+) (\d+) +" + _PATH)


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


def _descriptors(pid: int, wanted: tuple[int, int]) -> Iterator[str]:
    """Those of a process that are of the file, as links in /proc; none of a process this user may not look into."""
    with suppress(OSError):
        for number in os.listdir(f"/proc/{pid}/fd"):
            with suppress(OSError):
                if _file(os.stat(link := f"/proc/{pid}/fd/{number}")) == wanted:
                    yield link


def _file(status: os.stat_result) -> tuple[int, int]:
    return status.st_dev, status.st_ino


def _pids() -> list[int]:
    return sorted(int(name) for name in os.listdir("/proc") if name.isdigit())
