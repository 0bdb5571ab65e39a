"""List the processes that map files of /dev/shm, and find out their names and whether they are 32-bit, from /proc."""

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
    """A file in a /dev/shm that the process `pid` has mapped into its memory.

    `device` distinguishes this /dev/shm from that of a container. If `removed` is True, the file has been deleted
    since. `addresses` is the range of memory as in /proc/PID/map_files.
    """

    pid: int
    name: str
    device: int
    inode: int
    removed: bool
    addresses: str

    def is_region(self) -> bool | None:
        """Return True if the file begins with the magic number of a region, otherwise False.

        Return None if this user may not read the file.
        """
        for place in self._places():
            with suppress(OSError):
                descriptor = os.open(place, os.O_RDONLY | os.O_CLOEXEC | os.O_NONBLOCK)
                with open(descriptor, "rb", buffering=0) as file:
                    if _file(os.fstat(descriptor)) == (self.device, self.inode):
                        return int.from_bytes(file.read(4), "little") == h.MAGIC
        return None

    def _places(self) -> Iterator[str]:
        """Yield paths in /proc by which the mapped file may be opened.

        Only root can open the first path. The other paths are descriptors of the process, and the name in /dev/shm as
        the process sees that folder.
        """
        yield f"/proc/{self.pid}/map_files/{self.addresses}"
        yield from _descriptors(self.pid, (self.device, self.inode))
        if not self.removed:
            yield f"/proc/{self.pid}/root{FOLDER}/{self.name}"


@dataclass(frozen=True, slots=True)
class Processes:
    """The files of /dev/shm that processes have mapped, at one instant.

    `hidden` is the number of processes that this user may not inspect.
    """

    mappings: tuple[Mapping, ...]
    hidden: int

    def users(self, status: os.stat_result) -> list[int]:
        """Return the pids of all processes that have mapped the file with this `status`, in ascending order."""
        return [mapping.pid for mapping in self.mappings if (mapping.device, mapping.inode) == _file(status)]


def look() -> Processes:
    """Return the files of /dev/shm that processes have mapped, for all processes that this user may inspect."""
    mappings: dict[tuple[int, int, int], Mapping] = {}
    hidden = 0
    for pid in _pids():
        try:
            for mapping in _read_maps(pid):
                mappings.setdefault((mapping.pid, mapping.device, mapping.inode), mapping)
        except PermissionError:
            hidden += 1
        except OSError:  # the process has ended
            continue
    return Processes(tuple(mappings.values()), hidden)


def has_open(status: os.stat_result) -> bool:
    """Return True if a process has the file with this `status` open.

    Processes that this user may not inspect are left out.
    """
    return any(True for pid in _pids() for _ in _descriptors(pid, (status.st_dev, status.st_ino)))


def alive(pid: int) -> bool:
    """Return True if the process `pid` runs. A zombie, which has ended but was not collected, does not run."""
    try:
        with open(f"/proc/{pid}/stat", encoding="utf-8", errors="replace") as file:
            return file.read().rpartition(")")[2].split()[0] not in ("Z", "X")
    except OSError:
        return False


def called(pid: int) -> str:
    """Return the name and arguments of a process, shortened, or "" if the process is gone.

    A Python script appears without its interpreter: `talker.py --rate 10`.
    """
    try:
        words = _command(pid)
    except OSError:
        return ""
    while len(words) > 2 and _EMULATOR.fullmatch(words[0]) and not words[1].startswith("-"):
        # The emulator is followed by the program's path, and by argv[0] if the kernel is set to preserve it.
        has_argv0 = words[0].endswith("-P") or os.path.basename(words[1]) == os.path.basename(words[2])
        del words[: 1 + has_argv0]
    if len(words) > 2 and os.path.basename(words[0]).startswith("python") and not words[1].startswith("-"):
        del words[0]
    line = " ".join([os.path.basename(words[0]), *(word for word in words[1:] if word)])
    line = legible(" ".join(line.split()))
    return line if len(line) <= 40 else line[:37] + "..."


def bits(pid: int) -> int | None:
    """Return 32 or 64, the number of bits of the program that a process runs.

    If the process is the emulator qemu, return the bits of the emulated machine. Return None if this user may not
    inspect the process.
    """
    try:
        with open(f"/proc/{pid}/exe", "rb") as file:
            bits_of_program = {1: 32, 2: 64}.get(file.read(5)[-1])
        emulator = _EMULATOR.fullmatch(_command(pid)[0])
    except (OSError, IndexError):
        return None
    if emulator:
        return 64 if "64" in (emulator[1] or emulator[2]) else 32
    return bits_of_program


_KIND = "aarch64|arm|i386|riscv64|x86_64"
_EMULATOR = re.compile(rf"(?:.*/)?(?:qemu-({_KIND})(?:-static)?|({_KIND})-binfmt-P)")
"""Names of qemu-user: upstream, in docker's images, and in Debian."""


def _command(pid: int) -> list[str]:
    with open(f"/proc/{pid}/cmdline", "rb") as file:
        return file.read().decode(errors="replace").split("\0")


_PATH = r"(?:/.*)?/dev/shm/(.+?)( \(deleted\))?\n?"
"""Inside a chroot, a path outside the chroot begins with the path of the chroot."""

_LINE = re.compile(r"([0-9a-f]+)-([0-9a-f]+) \S+ \S+ ([0-9a-f]+):([0-9a-f]+) (\d+) +" + _PATH)


def _read_maps(pid: int) -> Iterator[Mapping]:
    with open(f"/proc/{pid}/maps", encoding="utf-8", errors="replace") as file:
        for line in file:
            if match := _LINE.fullmatch(line):
                start, end, major, minor, inode, name, removed = match.groups()
                yield Mapping(
                    pid,
                    name,
                    os.makedev(int(major, 16), int(minor, 16)),
                    int(inode),
                    bool(removed),
                    f"{int(start, 16):x}-{int(end, 16):x}",
                )


def _descriptors(pid: int, file: tuple[int, int]) -> Iterator[str]:
    """Yield the path in /proc of each descriptor with which process `pid` has a file open.

    `file` is the device and inode of the file. Yield nothing if this user may not inspect the process.
    """
    with suppress(OSError):
        for number in os.listdir(f"/proc/{pid}/fd"):
            with suppress(OSError):
                if _file(os.stat(link := f"/proc/{pid}/fd/{number}")) == file:
                    yield link


def _file(status: os.stat_result) -> tuple[int, int]:
    return status.st_dev, status.st_ino


def _pids() -> list[int]:
    return sorted(int(name) for name in os.listdir("/proc") if name.isdigit())
