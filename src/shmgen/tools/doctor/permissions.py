"""Problems of owner, group, mode and kind of a region's files: who may not open them, and who should not."""

from __future__ import annotations

import os
import stat
from collections.abc import Iterable, Iterator
from contextlib import suppress

from shmgen.live.regions import topic_of
from shmgen.runtime.errors import PermissionDenied, ShmError
from shmgen.runtime.region.access import Access, RegionOptions, access_for, name_of_group, name_of_user
from shmgen.runtime.region.looks import foreign, read_header
from shmgen.runtime.region.names import event_name, region_file, semaphore_file
from shmgen.tools.doctor.problem import Problem, owner
from shmgen.tools.doctor.snapshot import Evidence


def of_files(seen: Evidence) -> Iterator[Problem]:
    """Of the files of one region."""
    file = region_file(seen.name)
    if not os.access(file, os.R_OK | os.W_OK):
        yield Problem(
            seen.topic, f"this user cannot open it for reading and writing: {owner(seen.status)}", *join(file)
        )
    lock = seen.semaphores[1]
    yield from _access(seen)
    if (
        seen.wanted.regions.mode is None
        and lock
        and stat.S_ISREG(lock.status.st_mode)
        and (lock.status.st_gid, lock.status.st_mode & 0o666) != (seen.status.st_gid, seen.status.st_mode & 0o666)
    ):
        message = (
            f"the region is {owner(seen.status)}, its semaphore {owner(lock.status)}: not all can lock who can read"
        )
        other = semaphore_file(seen.name)
        hint = f"`chown --reference={file} {other}; chmod --reference={file} {other}`"
        yield Problem(seen.topic, message, hint, other)
    rule = _protected_regular()
    if rule and seen.status.st_uid != 0:
        message = (
            f"fs.protected_regular is {rule}: a program that opens it with O_CREAT gets EACCES, unless it runs as "
            f"{name_of_user(seen.status.st_uid)}, who owns it; not even root may"
        )
        hint = "let that program make the region first, or run both sides as the same user"
        yield Problem(seen.topic, message, hint, file, note=True)


def _access(seen: Evidence) -> Iterator[Problem]:
    """Mode and group of each file beside those of [regions]; without a mode there, what a umask has left of one."""
    mode, group = seen.wanted.regions.mode, seen.wanted.regions.group
    for file in _files(seen.name):
        with suppress(FileNotFoundError):
            status = os.lstat(file)
            if not stat.S_ISREG(status.st_mode):
                continue
            found = status.st_mode & 0o7777
            if mode in (None, found):
                yield from _strangers(seen, status, file)
            else:
                message = f'its mode is {found:04o}, and mode = "{mode:04o}" in shmgen.toml'
                yield Problem(seen.topic, message, f"`chmod {mode:04o} {file}`", file)
            if group and group != name_of_group(status.st_gid):
                message = f'its group is {name_of_group(status.st_gid)}, and group = "{group}" in shmgen.toml'
                yield Problem(seen.topic, message, f"`chgrp {group} {file}`", file)
            if mode is None and found & 0o060 == 0o040:
                message = f"its mode is {found:04o}, so that its group may read it and not write it; it takes both"
                yield Problem(seen.topic, message, f"`chmod g+w {file}`", file, note=True)


def of_places(names: Iterable[str]) -> Iterator[Problem]:
    """What is no region, and no regular file, where a region or a semaphore would be."""
    for name in names:
        with suppress(ShmError):
            if (header := read_header(name)).foreign:
                what, _, hint = str(foreign(region_file(name), header)).partition("\n  hint: ")
                yield Problem(topic_of(name), what, hint, region_file(name))
        for file in _files(name):
            with suppress(FileNotFoundError):
                kind = stat.S_IFMT(os.lstat(file).st_mode)
                if kind != stat.S_IFREG:
                    message = (
                        f"in the place of a file is {_KINDS.get(kind, 'a device')}, and programs refuse it for that"
                    )
                    yield Problem(topic_of(name), message, f"see whose it is, `ls -l {file}`, and remove it", file)


_KINDS = {
    stat.S_IFLNK: "a symbolic link",
    stat.S_IFIFO: "a FIFO",
    stat.S_IFDIR: "a folder",
    stat.S_IFSOCK: "a socket",
}


def _strangers(seen: Evidence, status: os.stat_result, file: str) -> Iterator[Problem]:
    """By the rule that programs go by: what all may write is a fault; whom root does not know, others may."""
    said = seen.wanted.regions
    access = Access(said.mode, None)
    with suppress(PermissionDenied):  # there is no such group
        access = access_for(RegionOptions(said.mode, said.group or None))
    if objection := access.objection(status, file):
        who, leave = objection
        only_root = os.geteuid() == 0 and not status.st_mode & stat.S_IWOTH
        refuse = "programs of root refuse it" if only_root else "programs refuse it"
        yield Problem(seen.topic, f"{who}, and {refuse} for that", leave, file, note=only_root)


def _files(name: str) -> tuple[str, ...]:
    return region_file(name), semaphore_file(name), semaphore_file(event_name(name))


def join(file: str) -> tuple[str, str]:
    """What to do about a file one may not open, and the file."""
    status = os.lstat(file)
    group = owner(status).partition(":")[2].partition(",")[0]
    return f"join its group (`sudo usermod -aG {group} $USER`, then log in again); it is {owner(status)}", file


def _protected_regular() -> int:
    try:
        with open("/proc/sys/fs/protected_regular", encoding="ascii") as file:
            return int(file.read())
    except (OSError, ValueError):
        return 0
