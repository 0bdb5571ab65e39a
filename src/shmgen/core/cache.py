"""Keeps what only saves time, in the user's cache folder: definitions of the store, and clean checks.

Some of it is code, so nothing counts that another user could have put there, and whoever runs as root trusts no cache
of others: folder and file belong to this user, and nobody else may write to them. On Windows, which tells neither this
way, nothing is kept. Loads next to nothing.
"""

from __future__ import annotations

import os
import stat
import zlib

OFF = "SHMGEN_NO_CACHE"
"""The environment variable that turns it off, whatever its value, if that is not empty."""


def read(name: str) -> bytes | None:
    """What was kept under a name; None if nothing was, or it is damaged, or might be somebody else's."""
    try:
        folder = _folder()
        try:
            flags = os.O_RDONLY | os.O_NOFOLLOW | os.O_NONBLOCK | os.O_CLOEXEC
            with open(os.open(name, flags, dir_fd=folder), "rb") as file:
                status = os.fstat(file.fileno())
                if not stat.S_ISREG(status.st_mode) or not _is_ours(status):
                    return None
                checksum, _, content = file.read().partition(b"\n")
        finally:
            os.close(folder)
        return content if int(checksum, 16) == zlib.crc32(content) else None
    except (OSError, ValueError):
        return None


def write(name: str, content: bytes) -> None:
    """Keeps it whole or not at all; what cannot be kept is done without."""
    beside = f"{name}.{os.getpid()}"
    try:
        folder = _folder(make=True)
    except OSError:
        return
    try:
        flags = os.O_WRONLY | os.O_CREAT | os.O_TRUNC | os.O_NOFOLLOW | os.O_CLOEXEC
        with open(os.open(beside, flags, 0o600, dir_fd=folder), "wb") as file:
            file.write(b"%08x\n" % zlib.crc32(content) + content)
        os.replace(beside, name, src_dir_fd=folder, dst_dir_fd=folder)
    except OSError:
        _unlink(beside, folder)
    finally:
        os.close(folder)


def forget(beginning: str, but: int) -> None:
    """All whose names begin so, but for the newest few."""
    try:
        folder = _folder()
    except OSError:
        return
    try:
        found = [(entry.stat().st_mtime_ns, entry.name) for entry in os.scandir(folder)]
        for _, name in sorted(kept for kept in found if kept[1].startswith(beginning))[:-but]:
            _unlink(name, folder)
    except OSError:
        pass  # somebody else forgets at the same time
    finally:
        os.close(folder)


def _folder(*, make: bool = False) -> int:
    """A descriptor of `$XDG_CACHE_HOME/shmgen`. Raises OSError where nothing may be kept.

    As the XDG base directory specification says, a value that is not absolute is ignored.
    """
    if not hasattr(os, "geteuid"):
        raise OSError
    base = os.environ.get("XDG_CACHE_HOME", "")
    if not os.path.isabs(base):
        base = os.path.join(os.path.expanduser("~"), ".cache")
    if os.environ.get(OFF) or not os.path.isabs(base):
        raise OSError
    path = os.path.join(base, "shmgen")
    if make and not os.path.lexists(path):
        _make(path)
    folder = os.open(path, os.O_RDONLY | os.O_DIRECTORY | os.O_NOFOLLOW | os.O_CLOEXEC)
    if not _is_ours(os.fstat(folder)):
        os.close(folder)
        raise PermissionError
    return folder


def _make(path: str) -> None:
    """Not in another user's home, as when root runs with the `HOME` of somebody else, who could use it no more."""
    above = os.path.dirname(path)
    while not os.path.exists(above):
        above = os.path.dirname(above)
    if os.stat(above).st_uid in (0, os.geteuid()):
        os.makedirs(path, mode=0o700, exist_ok=True)


def _is_ours(status: os.stat_result) -> bool:
    return status.st_uid == os.geteuid() and not status.st_mode & (stat.S_IWGRP | stat.S_IWOTH)


def _unlink(name: str, folder: int) -> None:
    try:  # noqa: SIM105 contextlib takes longer to load than the whole of this
        os.unlink(name, dir_fd=folder)
    except OSError:
        pass
