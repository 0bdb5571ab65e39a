"""Finds problems around the regions: removed regions in use, a full /dev/shm, and removal of regions at logout."""

from __future__ import annotations

import os
from collections.abc import Collection, Iterator, Sequence
from contextlib import suppress
from pathlib import Path

from shmgen.core.plural import counted
from shmgen.live.processes import Processes, called
from shmgen.live.regions import FOLDER, closed, is_name, topic_of
from shmgen.runtime.region.access import name_of_user
from shmgen.runtime.region.names import region_file
from shmgen.tools.doctor.clean import orphan_semaphores
from shmgen.tools.doctor.permissions import advice_to_join
from shmgen.tools.doctor.problem import Problem
from shmgen.tools.doctor.snapshot import Evidence, semaphore

_PLACES = ("etc", "run", "usr/local/lib", "usr/lib")
"""Folders that may contain systemd/logind.conf and its drop-ins. The first logind.conf counts; drop-ins override it."""
_FIRST_USER = 1000
"""Lowest user id of a person. logind keeps the regions of system users, whose ids are lower."""
_TYPE = (
    "`sudo mkdir -p /etc/systemd/logind.conf.d && printf '[Login]\\nRemoveIPC=no\\n' | "
    "sudo tee /etc/systemd/logind.conf.d/shmgen.conf && sudo systemctl restart systemd-logind`; "
    "or create the regions as a service: docs/deploy.md"
)


def of_detached(processes: Processes, names: Collection[str], requested: Collection[str]) -> Iterator[Problem]:
    """Yield a problem for each process that still uses a removed region or semaphore, or a region in another /dev/shm.

    `names` are the existing and the configured regions; `requested` are the regions that the user named. A container
    whose regions are private has its own /dev/shm on purpose. A region in another /dev/shm is therefore a problem only
    if `names` contains the region, and one of these conditions is true:

    * `requested` contains the region.
    * Exactly one process maps the region in this /dev/shm, or exactly one maps the region in the other /dev/shm.
    """
    ours = os.stat(FOLDER).st_dev
    pairs = {(mapping.pid, mapping.device, mapping.name) for mapping in processes.mappings}
    for mapping in processes.mappings:
        region = mapping.name.removeprefix("sem.")
        if not is_name(region):
            continue
        topic, who = topic_of(region), f"process {mapping.pid} ({called(mapping.pid)})"
        file = f"/dev/shm/{mapping.name}"
        if region != mapping.name:  # a semaphore
            if mapping.removed and mapping.device == ours and region in names and semaphore(region):
                message = f"{who} uses a semaphore that was removed, so its lock excludes no other process"
                yield Problem(topic, message, f"restart process {mapping.pid}", file, mapping.pid)
            continue
        likely = region in names or (mapping.pid, mapping.device, f"sem.{region}") in pairs
        is_region = mapping.is_region()
        if not (likely if is_region is None else is_region):
            continue
        if mapping.device != ours:
            here, there = (len(_holders(processes, device, region)) for device in (ours, mapping.device))
            if region not in names or not (1 in (here, there) or region in requested):
                continue
            message = f"{who} has this region in another /dev/shm, so neither side sees the other"
            hint = "start its container with `--ipc=host`, or `-v /dev/shm:/dev/shm`"
            yield Problem(topic, message, hint, file, mapping.pid)
        elif mapping.removed:
            message = f"{who} still uses a region that was removed; no other process receives its samples"
            yield Problem(topic, message, f"restart process {mapping.pid}", file, mapping.pid)


def _holders(processes: Processes, device: int, name: str) -> set[int]:
    """Return the pids of the processes that map a region in the /dev/shm with this device number."""
    return {mapping.pid for mapping in processes.mappings if (mapping.device, mapping.name) == (device, name)}


def of_machine(processes: Processes) -> Iterator[Problem]:
    """Yield problems that concern all regions, such as the size of /dev/shm, and files that this user cannot read."""
    for name in closed():
        with suppress(FileNotFoundError):  # removed meanwhile
            hint = advice_to_join(os.lstat(file := region_file(name)))
            yield Problem(topic_of(name), "this file may be a region, but this user cannot read it", hint, file)
    for file in orphan_semaphores(processes):
        message = "a process was killed while it created a semaphore, and left this unused file"
        yield Problem("", message, f"`rm {file}`; `shmgen clean --all` removes it too", file, note=True)
    yield from _of_folder()
    size = os.statvfs("/dev/shm")
    total, free = size.f_blocks * size.f_frsize, size.f_bavail * size.f_frsize
    if free < total // 20:
        message = f"/dev/shm is nearly full: {free >> 10} of {total >> 10} KiB are free"
        yield Problem("", message, "remove files (`ls -lS /dev/shm`), or raise docker's `--shm-size`", "/dev/shm")
    if _in_container() and (_own_mount() or total <= 64 << 20):
        message = f"this container has its own /dev/shm ({total >> 20} MiB), so it shares no regions with the host"
        hint = "to share regions, start the container with `--ipc=host`, or `-v /dev/shm:/dev/shm`"
        yield Problem("", message, hint, "/dev/shm", note=True)
    if processes.hidden and os.geteuid() != 0:
        message = f"{counted(processes.hidden, 'process')} of other users could not be inspected"
        yield Problem("", message, "run `sudo shmgen doctor` to inspect them too", note=True)


def _of_folder() -> Iterator[Problem]:
    mode = os.stat("/dev/shm").st_mode & 0o7777
    if mode & 0o1777 != 0o1777:
        who = "other users can remove its files" if mode & 0o777 == 0o777 else "other users cannot create regions"
        message = f"the mode of /dev/shm is {mode:04o} instead of 1777, so {who}"
        yield Problem("", message, "`sudo chmod 1777 /dev/shm`; in a container, mount it with mode=1777", "/dev/shm")


def _in_container() -> bool:
    if any(map(os.path.exists, ("/.dockerenv", "/run/.containerenv"))):
        return True
    with suppress(OSError), open("/proc/1/environ", "rb") as file:
        return b"\0container=" in b"\0" + file.read()
    return False


def _own_mount() -> bool:
    """Return True if /dev/shm belongs to this container only.

    Docker and podman mount a container's own tmpfs from the source `shm`. The host's /dev/shm has another source.
    """
    with suppress(OSError), open("/proc/mounts", encoding="utf-8", errors="replace") as file:
        return any(line.split()[:2] == ["shm", "/dev/shm"] for line in file)
    return False


def of_logout(regions: Sequence[Evidence], root: Path = Path("/")) -> Iterator[Problem]:
    """Yield a note for each owner of regions if systemd-logind removes the owner's regions at logout."""
    owners = sorted({region.status.st_uid for region in regions if region.status.st_uid >= _FIRST_USER})
    if not owners or not (root / "run/systemd/seats").is_dir() or not removes_ipc(root):
        return
    for owner in owners:
        topics = [region.topic for region in regions if region.status.st_uid == owner]
        listed = ", ".join(topics[:3]) + (", ..." if len(topics) > 3 else "")
        message = f"systemd-logind removes {listed} when {name_of_user(owner)} logs out (RemoveIPC=yes)"
        yield Problem("", message, _TYPE, note=True)


def removes_ipc(root: Path = Path("/")) -> bool:
    """Return True if RemoveIPC= is yes, the default, in logind.conf and its drop-ins below `root`."""
    mains = (root / place / "systemd/logind.conf" for place in _PLACES)
    drop_ins: dict[str, Path] = {}
    for place in reversed(_PLACES):
        drop_ins |= {path.name: path for path in (root / place / "systemd/logind.conf.d").glob("*.conf")}
    files = [*[path for path in mains if path.is_file()][:1], *(drop_ins[name] for name in sorted(drop_ins))]
    settings = [value for path in files for value in _settings(path)]
    return not settings or settings[-1] not in ("no", "0", "false", "off", "n", "f")


def _settings(path: Path) -> Iterator[str]:
    try:
        lines = path.read_text(encoding="utf-8", errors="replace").splitlines()
    except OSError:
        return
    for line in lines:
        key, _, value = line.partition("=")
        if key.strip() == "RemoveIPC":
            yield value.strip().lower()
