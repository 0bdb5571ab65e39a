"""Checks owner, group, mode and type of a region's files, and finds files that too few or too many users can open."""

from __future__ import annotations

import os
import stat
from collections.abc import Iterable, Iterator
from contextlib import suppress

from shmgen.live.regions import is_denied, topic_of
from shmgen.runtime.errors import PermissionDenied, ShmError
from shmgen.runtime.region.access import Access, RegionOptions, access_for, name_of_group, name_of_user, way_in
from shmgen.runtime.region.checks import not_a_region_error, read_header
from shmgen.runtime.region.names import event_name, region_file, semaphore_file
from shmgen.tools.doctor.problem import Problem, owner
from shmgen.tools.doctor.snapshot import Evidence


def of_files(region: Evidence) -> Iterator[Problem]:
    """Yield the problems with owner, group, mode and type of one region's files."""
    file = region_file(region.name)
    if is_denied(file, os.O_RDWR):
        message = f"this user cannot open the region for reading and writing: {owner(region.status)}"
        yield Problem(region.topic, message, advice_to_join(region.status), file)
    lock = region.semaphores[1]
    yield from _access(region)
    if (
        region.expected.regions.mode is None
        and lock
        and stat.S_ISREG(lock.status.st_mode)
        and (lock.status.st_gid, lock.status.st_mode & 0o666) != (region.status.st_gid, region.status.st_mode & 0o666)
    ):
        message = (
            f"the region is {owner(region.status)}, but its semaphore is {owner(lock.status)}: "
            "some users can read, but not lock"
        )
        other = semaphore_file(region.name)
        hint = f"`chown --reference={file} {other}; chmod --reference={file} {other}`"
        yield Problem(region.topic, message, hint, other)
    rule = _protected_regular()
    if rule and region.status.st_uid != 0:
        message = (
            f"fs.protected_regular is {rule}: a program that opens this file with O_CREAT gets EACCES, also as root, "
            f"unless it runs as the owner {name_of_user(region.status.st_uid)}"
        )
        hint = "start that program first, so that it creates the region, or run both sides as the same user"
        yield Problem(region.topic, message, hint, file, note=True)


def _access(region: Evidence) -> Iterator[Problem]:
    """Compare the mode and group of each file with [regions], and report files that untrusted users can write.

    If [regions] has no mode, also report files that their group can read but not write, usually because of a umask.
    """
    mode, group = region.expected.regions.mode, region.expected.regions.group
    for file in _files(region.name):
        with suppress(FileNotFoundError):
            status = os.lstat(file)
            if not stat.S_ISREG(status.st_mode):
                continue
            present_mode = status.st_mode & 0o7777
            if mode in (None, present_mode):
                yield from _strangers(region, status, file)
            else:
                message = f'the mode is {present_mode:04o}, but shmgen.toml has mode = "{mode:04o}"'
                yield Problem(region.topic, message, f"`chmod {mode:04o} {file}`", file)
            if group and group != name_of_group(status.st_gid):
                message = f'the group is {name_of_group(status.st_gid)}, but shmgen.toml has group = "{group}"'
                yield Problem(region.topic, message, f"`chgrp {group} {file}`", file)
            if mode is None and present_mode & 0o060 == 0o040:
                message = f"the mode is {present_mode:04o}: the group may read the file, but also needs to write it"
                yield Problem(region.topic, message, f"`chmod g+w {file}`", file, note=True)


def of_places(names: Iterable[str]) -> Iterator[Problem]:
    """Yield a problem for each region or semaphore that is not a regular file, or not a file of shmgen.

    `names` are the names of the regions.
    """
    for name in names:
        with suppress(ShmError):
            if (header := read_header(name)).foreign:
                what, _, hint = str(not_a_region_error(region_file(name), header)).partition("\n  hint: ")
                yield Problem(topic_of(name), what, hint, region_file(name))
        for file in _files(name):
            with suppress(FileNotFoundError):
                kind = stat.S_IFMT(os.lstat(file).st_mode)
                if kind != stat.S_IFREG:
                    message = f"this is {_KINDS.get(kind, 'a device')} instead of a regular file, so programs refuse it"
                    yield Problem(topic_of(name), message, f"`ls -l {file}` shows its owner; remove it", file)


_KINDS = {
    stat.S_IFLNK: "a symbolic link",
    stat.S_IFIFO: "a FIFO",
    stat.S_IFDIR: "a folder",
    stat.S_IFSOCK: "a socket",
}


def _strangers(region: Evidence, status: os.stat_result, file: str) -> Iterator[Problem]:
    """Yield a problem if untrusted users can write the file, because publishers and subscribers then refuse the file.

    If this user is root and only some users can write the file, the problem is only a note. Publishers and subscribers
    of other users may then accept the file.
    """
    options = region.expected.regions
    access = Access(options.mode, None)
    with suppress(PermissionDenied):  # the group does not exist
        access = access_for(RegionOptions(options.mode, options.group or None))
    if objection := access.objection(status, file):
        who, leave = objection
        only_root = os.geteuid() == 0 and not status.st_mode & stat.S_IWOTH
        refuse = "programs of root refuse this file" if only_root else "programs refuse this file"
        yield Problem(region.topic, f"{who}, so {refuse}", leave, file, note=only_root)


def _files(name: str) -> tuple[str, ...]:
    return region_file(name), semaphore_file(name), semaphore_file(event_name(name))


def advice_to_join(status: os.stat_result) -> str:
    """Return a text with the owner, group and mode of a file, and advice for a user who cannot open the file."""
    return f"it is {owner(status)}: {way_in(status)}"


def _protected_regular() -> int:
    try:
        with open("/proc/sys/fs/protected_regular", encoding="ascii") as file:
            return int(file.read())
    except (OSError, ValueError):
        return 0
