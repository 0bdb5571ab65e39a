"""Turns evidence about a region into findings: what is wrong, which file, which process, what to do next."""

from __future__ import annotations

import grp
import os
import pwd
from collections.abc import Iterator
from contextlib import suppress
from dataclasses import dataclass

from shmgen.live.processes import Processes, alive, called
from shmgen.live.regions import closed, topic_of
from shmgen.runtime import header as h
from shmgen.runtime.names import event_name, region_file, semaphore_file
from shmgen.tools import unfinished
from shmgen.tools.evidence import Evidence, own_device, semaphore

_ADVICE_CLEAN = "stop both sides, `shmgen clean {topic}`, start them again"


@dataclass(frozen=True, slots=True)
class Finding:
    """`file` and `process` (a pid) are None where none is at fault. A note is no fault, only good to know."""

    topic: str
    message: str
    hint: str
    file: str | None = None
    process: int | None = None
    note: bool = False


def of_region(seen: Evidence) -> Iterator[Finding]:
    """All that is wrong with one region and its semaphore."""
    for check in (_header, _layout, _writer, _permissions, _semaphore, _lock, _bitness):
        yield from check(seen)


def of_strays(processes: Processes, names: list[str]) -> Iterator[Finding]:
    """Processes that hold on to a removed region or semaphore, or to one in another /dev/shm."""
    ours = own_device()
    for found in processes.mappings:
        region = found.name.removeprefix("sem.")
        topic, who = topic_of(region), f"process {found.pid} ({called(found.pid)})"
        file = f"/dev/shm/{found.name}"
        if found.semaphore:
            if found.removed and found.device == ours and region in names and semaphore(region):
                message = f"{who} locks with a semaphore that was removed, so its lock keeps nobody out"
                yield Finding(topic, message, f"restart process {found.pid}", file, found.pid)
            continue
        if not (found.is_region() or (found.is_region() is None and region in names)):
            continue
        if found.device != ours:
            message = f"{who} has this region in a /dev/shm of its own, so neither side sees the other"
            hint = "start its container with the host's: `--ipc=host`, or `-v /dev/shm:/dev/shm`"
            yield Finding(topic, message, hint, file, found.pid)
        elif found.removed:
            message = f"{who} still holds a region that was removed; nobody else sees what it writes there"
            yield Finding(topic, message, f"restart process {found.pid}", file, found.pid)


def of_machine(processes: Processes) -> Iterator[Finding]:
    """What holds for all regions: this container's /dev/shm, the kernel's rules, and what cannot be seen."""
    for name in closed():
        yield Finding(topic_of(name), "this may be a region, but this user cannot read it", *_join(region_file(name)))
    for file in unfinished.semaphores(processes):
        message = "somebody was killed while making a semaphore; nothing uses this file"
        yield Finding("", message, f"`rm {file}`; `shmgen clean --all` removes it too", file, note=True)
    size = os.statvfs("/dev/shm")
    total, free = size.f_blocks * size.f_frsize, size.f_bavail * size.f_frsize
    if free < total // 20:
        message = f"/dev/shm is nearly full: {free >> 10} of {total >> 10} KiB are left"
        yield Finding("", message, "see `ls -lS /dev/shm`; docker: `--shm-size`", "/dev/shm")
    if _in_container() and (_own_mount() or total <= 64 << 20):
        message = (
            f"this is a container with a /dev/shm of its own ({total >> 20} MiB): it shares no region with the host"
        )
        hint = "to share them start it with `--ipc=host`, or `-v /dev/shm:/dev/shm`"
        yield Finding("", message, hint, "/dev/shm", note=True)
    if processes.hidden and os.geteuid() != 0:
        message = f"{processes.hidden} processes of other users could not be looked into"
        yield Finding("", message, "`sudo shmgen doctor` sees who maps what", note=True)


def _header(seen: Evidence) -> Iterator[Finding]:
    header, file = seen.after, region_file(seen.name)
    if header.abi != h.ABI or header.header_size != h.HEADER_SIZE:
        message = f"it was made by another version of shmgen: ABI {header.abi}, here {h.ABI}"
        yield Finding(seen.topic, message, "use the same version of shmgen on both sides", file)
        return
    size = h.HEADER_SIZE + header.slots * header.slot_size
    if header.size < size or header.slots < 2:
        message = f"the file has {header.size:,} bytes, its {header.slots} slots of {header.slot_size} need {size:,}"
        yield Finding(seen.topic, message, _ADVICE_CLEAN.format(topic=seen.topic), file)


def _layout(seen: Evidence) -> Iterator[Finding]:
    header, file, wanted, layout = seen.after, region_file(seen.name), seen.wanted, seen.layout
    package, _, bare = header.type_name.partition("/")
    if wanted.type and wanted.type not in (header.type_name, f"{package}/{bare.rpartition('/')[2]}"):
        message = f"it holds {header.type_name}, and shmgen.toml says {wanted.type}"
        yield Finding(seen.topic, message, _ADVICE_CLEAN.format(topic=seen.topic), file)
    elif layout and (layout.digest, layout.size) != (header.digest, header.payload_size):
        message = (
            f"it has another layout of {header.type_name} than this folder: "
            f"digest 16#{header.digest:016X}, {header.payload_size} bytes there; {layout}"
        )
        hint = "`shmgen generate`, rebuild both sides; " + _ADVICE_CLEAN.format(topic=seen.topic)
        yield Finding(seen.topic, message, hint, file)
    elif wanted.depth and (slots := 1 << wanted.depth.bit_length()) != header.slots:
        message = f"it has {header.slots} slots, and depth = {wanted.depth} in shmgen.toml takes {slots}"
        hint = "give both sides the same depth; " + _ADVICE_CLEAN.format(topic=seen.topic)
        yield Finding(seen.topic, message, hint, file)


def _writer(seen: Evidence) -> Iterator[Finding]:
    """That a writer is gone is nothing wrong; that it was killed at work is good to know."""
    writer = seen.after.writer
    before, after = ((look.begun, look.completed, look.heartbeat) for look in (seen.before, seen.after))
    if seen.claimed or before != after or seen.after.begun == seen.after.completed:
        return
    who = "the PLC" if writer == h.PLC else f"process {writer}"
    message = f"{who} ended while it wrote sample {seen.after.begun}; sample {seen.after.completed} is whole"
    yield Finding(seen.topic, message, "start it again: it goes on from there", region_file(seen.name), writer, True)


def _permissions(seen: Evidence) -> Iterator[Finding]:
    file = region_file(seen.name)
    if not os.access(file, os.R_OK | os.W_OK):
        yield Finding(
            seen.topic, f"this user cannot open it for reading and writing: {owner(seen.status)}", *_join(file)
        )
    lock = seen.semaphores[1]
    yield from _access(seen)
    if (
        seen.wanted.regions.mode is None
        and lock
        and (lock.status.st_gid, lock.status.st_mode & 0o666) != (seen.status.st_gid, seen.status.st_mode & 0o666)
    ):
        message = (
            f"the region is {owner(seen.status)}, its semaphore {owner(lock.status)}: not all can lock who can read"
        )
        other = semaphore_file(seen.name)
        hint = f"`chown --reference={file} {other}; chmod --reference={file} {other}`"
        yield Finding(seen.topic, message, hint, other)
    rule = _protected_regular()
    if rule and seen.status.st_uid != 0:
        message = (
            f"fs.protected_regular is {rule}: a program that opens it with O_CREAT gets EACCES, unless it runs as "
            f"{_user(seen.status.st_uid)}, who owns it; not even root may"
        )
        hint = "let that program make the region first, or run both sides as the same user"
        yield Finding(seen.topic, message, hint, file, note=True)


def _access(seen: Evidence) -> Iterator[Finding]:
    """Mode and group of each file beside those of [regions]; without a mode there, what a umask has left of one."""
    mode, group = seen.wanted.regions.mode, seen.wanted.regions.group
    for file in (region_file(seen.name), *map(semaphore_file, (seen.name, event_name(seen.name)))):
        with suppress(FileNotFoundError):
            status = os.stat(file)
            found = status.st_mode & 0o7777
            if mode not in (None, found):
                message = f'its mode is {found:04o}, and mode = "{mode:04o}" in shmgen.toml'
                yield Finding(seen.topic, message, f"`chmod {mode:04o} {file}`", file)
            if group and group != _group(status.st_gid):
                message = f'its group is {_group(status.st_gid)}, and group = "{group}" in shmgen.toml'
                yield Finding(seen.topic, message, f"`chgrp {group} {file}`", file)
            if mode is None and found & 0o060 == 0o040:
                message = f"its mode is {found:04o}, so that its group may read it and not write it; it takes both"
                yield Finding(seen.topic, message, f"`chmod g+w {file}`", file, note=True)


def _semaphore(seen: Evidence) -> Iterator[Finding]:
    if seen.wanted.regions.sync == "sequence":
        return
    before, now = seen.semaphores
    file = semaphore_file(seen.name)
    if now is None:
        peers = [peer.pid for peer in seen.peers]
        message = "its semaphore is missing" + (", and processes that run lock each other out no more" if peers else "")
        hint = (
            f"restart {', '.join(f'process {pid}' for pid in peers)}" if peers else "the next that opens it makes one"
        )
        yield Finding(seen.topic, message, hint, file, note=not peers)
    elif before and min(before.word or 0, now.word or 0) > 1 and now.bits == 64:
        message = f"its semaphore is {now.word}, so that as many get in at a time"
        yield Finding(seen.topic, message, "the next publisher or subscriber that starts takes it down to 1", file)


def _lock(seen: Evidence) -> Iterator[Finding]:
    before, now = seen.semaphores
    stuck = before and now and before.word == 0 and now.word == 0 and before.bits == 64
    if not stuck or seen.before.lock_count != seen.after.lock_count:
        return
    holder = seen.after.lock_holder
    if holder == 0:
        who = "nobody that follows the protocol"
    elif holder == h.PLC:
        who = "a PLC"
    else:
        who = f"process {holder} ({called(holder)})" if alive(holder) else f"process {holder}, which is dead"
    message = f"its lock is held by {who}, and nobody has got in for {seen.seconds:.1f} s"
    hint = f"the next publisher or subscriber frees it within 1.2 s; with none, `shmgen clean {seen.topic}`"
    pid = holder if holder not in (0, h.PLC) else None
    yield Finding(seen.topic, message, hint, semaphore_file(seen.name), pid)


def _bitness(seen: Evidence) -> Iterator[Finding]:
    lock = seen.semaphores[1]
    maker = lock.bits if lock else None
    kinds = {peer.bits for peer in seen.peers if peer.bits} | ({maker} if maker and seen.peers else set())
    if len(kinds) > 1 and seen.wanted.regions.sync != "sequence":
        shown = ", ".join(f"{peer} has {peer.bits} bits" for peer in seen.peers if peer.bits)
        message = f"a semaphore does not cross bitness: {shown}; the semaphore was made in a {maker}-bit process"
        hint = 'write sync = "sequence" under [regions] in shmgen.toml, and generate both sides again'
        odd = next((peer.pid for peer in seen.peers if peer.bits == 32), None)
        yield Finding(seen.topic, message, hint, semaphore_file(seen.name), odd)


def owner(status: os.stat_result) -> str:
    """`root:robot, mode 660`."""
    return f"{_user(status.st_uid)}:{_group(status.st_gid)}, mode {status.st_mode & 0o7777:o}"


def _user(uid: int) -> str:
    try:
        return pwd.getpwuid(uid).pw_name
    except KeyError:
        return str(uid)


def _group(gid: int) -> str:
    try:
        return grp.getgrgid(gid).gr_name
    except KeyError:
        return str(gid)


def _join(file: str) -> tuple[str, str]:
    """What to do about a file one may not open, and the file."""
    status = os.stat(file)
    group = owner(status).partition(":")[2].partition(",")[0]
    return f"join its group (`sudo usermod -aG {group} $USER`, then log in again); it is {owner(status)}", file


def _protected_regular() -> int:
    try:
        with open("/proc/sys/fs/protected_regular", encoding="ascii") as file:
            return int(file.read())
    except (OSError, ValueError):
        return 0


def _in_container() -> bool:
    if any(map(os.path.exists, ("/.dockerenv", "/run/.containerenv"))):
        return True
    with suppress(OSError), open("/proc/1/environ", "rb") as file:
        return b"\0container=" in b"\0" + file.read()
    return False


def _own_mount() -> bool:
    """Docker and podman call the tmpfs that a container gets for itself `shm`; the host's is called otherwise."""
    with suppress(OSError), open("/proc/mounts", encoding="utf-8", errors="replace") as file:
        return any(line.split()[:2] == ["shm", "/dev/shm"] for line in file)
    return False
