"""Problems of the processes and the machine around the regions: what is held, hidden, full or apart."""

from __future__ import annotations

import os
from collections.abc import Collection, Iterator
from contextlib import suppress

from shmgen.core.plural import counted
from shmgen.live.processes import Processes, called
from shmgen.live.regions import closed, topic_of
from shmgen.runtime.region.names import region_file, region_name
from shmgen.tools.doctor import orphan_semaphores
from shmgen.tools.doctor.permissions import join
from shmgen.tools.doctor.problem import Problem
from shmgen.tools.doctor.snapshot import own_device, semaphore


def of_strays(processes: Processes, names: Collection[str], asked: Collection[str]) -> Iterator[Problem]:
    """Processes that hold on to a removed region or semaphore, or to one in another /dev/shm.

    `names` are the regions there are and those that are meant to be, `asked` those that a person asks for. What is
    in another /dev/shm is a fault only if it is one of these and somebody, here or there, is alone with it:
    containers that share no region have each their own, as they should.
    """
    ours = own_device()
    pairs = {(found.pid, found.device, found.name) for found in processes.mappings}
    for found in processes.mappings:
        region = found.name.removeprefix("sem.")
        if not _is_name(region):
            continue
        topic, who = topic_of(region), f"process {found.pid} ({called(found.pid)})"
        file = f"/dev/shm/{found.name}"
        if found.semaphore:
            if found.removed and found.device == ours and region in names and semaphore(region):
                message = f"{who} locks with a semaphore that was removed, so its lock excludes no other process"
                yield Problem(topic, message, f"restart process {found.pid}", file, found.pid)
            continue
        likely = region in names or (found.pid, found.device, f"sem.{region}") in pairs
        sure = found.is_region()
        if not (likely if sure is None else sure):
            continue
        if found.device != ours:
            here, there = (len(_holders(processes, device, region)) for device in (ours, found.device))
            if region not in names or not (1 in (here, there) or region in asked):
                continue
            message = f"{who} has this region in a /dev/shm of its own, so neither side sees the other"
            hint = "start its container with the host's: `--ipc=host`, or `-v /dev/shm:/dev/shm`"
            yield Problem(topic, message, hint, file, found.pid)
        elif found.removed:
            message = f"{who} still holds a region that was removed; nobody else sees what it writes there"
            yield Problem(topic, message, f"restart process {found.pid}", file, found.pid)


def _holders(processes: Processes, device: int, name: str) -> set[int]:
    """The processes that map that region of that /dev/shm."""
    return {found.pid for found in processes.mappings if (found.device, found.name) == (device, name)}


def _is_name(region: str) -> bool:
    """Whether a topic can be called so: the names of files are anybody's, and some are there to deceive."""
    with suppress(ValueError):
        return region_name(topic_of(region)) == region
    return False


def of_machine(processes: Processes) -> Iterator[Problem]:
    """What holds for all regions: this container's /dev/shm, the kernel's rules, and what cannot be seen."""
    for name in closed():
        yield Problem(topic_of(name), "this may be a region, but this user cannot read it", *join(region_file(name)))
    for file in orphan_semaphores.semaphores(processes):
        message = "somebody was killed while making a semaphore; nothing uses this file"
        yield Problem("", message, f"`rm {file}`; `shmgen clean --all` removes it too", file, note=True)
    size = os.statvfs("/dev/shm")
    total, free = size.f_blocks * size.f_frsize, size.f_bavail * size.f_frsize
    if free < total // 20:
        message = f"/dev/shm is nearly full: {free >> 10} of {total >> 10} KiB are left"
        yield Problem("", message, "see `ls -lS /dev/shm`; docker: `--shm-size`", "/dev/shm")
    if _in_container() and (_own_mount() or total <= 64 << 20):
        message = (
            f"this is a container with a /dev/shm of its own ({total >> 20} MiB): it shares no region with the host"
        )
        hint = "to share them start it with `--ipc=host`, or `-v /dev/shm:/dev/shm`"
        yield Problem("", message, hint, "/dev/shm", note=True)
    if processes.hidden and os.geteuid() != 0:
        message = f"{counted(processes.hidden, 'process')} of other users could not be looked into"
        yield Problem("", message, "`sudo shmgen doctor` sees who maps what", note=True)


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
