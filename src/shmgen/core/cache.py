"""Cache results that are expensive to compute, in the user's cache folder.

The entries are texts of message definitions, compiled templates, and the output of commands that found no error. Some
entries are code. An entry is therefore used only if its file and folder belong to this user and no other user may write
to them. On Windows, where this module cannot check the owner, nothing is cached.

This module imports as little as possible, so that a cached answer comes fast.
"""

from __future__ import annotations

import os
import stat
import zlib

OFF = "SHMGEN_NO_CACHE"
"""The environment variable that turns the cache off if its value is not empty."""


def read(name: str) -> bytes | None:
    """Return the content of the cache entry `name`, or None if the entry is missing, damaged or not safe.

    An entry is safe if only this user could have written it.
    """
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
    """Store `content` as the cache entry `name`, or, if an error occurs, do nothing."""
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


def forget(prefix: str, but: int) -> None:
    """Remove the cache entries whose names begin with `prefix`, except the newest `but` entries."""
    try:
        folder = _folder()
    except OSError:
        return
    try:
        with os.scandir(folder) as listing:
            entries = [(entry.stat(follow_symlinks=False).st_mtime_ns, entry.name) for entry in listing]
        for _, name in sorted(entry for entry in entries if entry[1].startswith(prefix))[:-but]:
            _unlink(name, folder)
    except OSError:
        pass  # another process removes entries at the same time
    finally:
        os.close(folder)


def _folder(*, make: bool = False) -> int:
    """Open the cache folder, `$XDG_CACHE_HOME/shmgen`, and return its descriptor. If `make`, create a missing folder.

    Raises OSError if the cache is off or the folder cannot be trusted. A relative path in XDG_CACHE_HOME is ignored, as
    the XDG base directory specification requires.
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
    """Create the cache folder if the nearest existing folder above it belongs to this user or to root.

    If the nearest folder belongs to another user, do nothing. Otherwise root, with HOME set to a user's folder, would
    create a cache folder to which this user cannot write.
    """
    above = os.path.dirname(path)
    while not os.path.exists(above):
        above = os.path.dirname(above)
    if os.stat(above).st_uid in (0, os.geteuid()):
        os.makedirs(path, mode=0o700, exist_ok=True)


def _is_ours(status: os.stat_result) -> bool:
    return status.st_uid == os.geteuid() and not status.st_mode & (stat.S_IWGRP | stat.S_IWOTH)


def _unlink(name: str, folder: int) -> None:
    try:  # noqa: SIM105 importing contextlib takes longer than this whole module
        os.unlink(name, dir_fd=folder)
    except OSError:
        pass
