"""Finds the problems of one region, each with the fault, the file, the process, and the next step for the user."""

from __future__ import annotations

import os
import stat
from collections.abc import Iterator

from shmgen.core import abi
from shmgen.core.plural import counted
from shmgen.live.processes import alive, called
from shmgen.live.regions import damage
from shmgen.runtime.engine import IN_C
from shmgen.runtime.reference.memory_order import has_barrier
from shmgen.runtime.region import header as h
from shmgen.runtime.region.names import region_file, semaphore_file
from shmgen.tools.doctor import permissions
from shmgen.tools.doctor.problem import Problem
from shmgen.tools.doctor.snapshot import SIZES, Evidence

_ADVICE_CLEAN = "stop both sides, run `shmgen clean {topic}`, restart them"


def of_region(region: Evidence) -> Iterator[Problem]:
    """Yield all problems of one region and its semaphore, from the evidence that `region` contains."""
    for check in (_header, _layout, permissions.of_files, _semaphore, _lock, _bitness):
        yield from check(region)


def _header(region: Evidence) -> Iterator[Problem]:
    header, file = region.after, region_file(region.name)
    if why := damage(header):
        clean = _ADVICE_CLEAN.format(topic=region.topic)
        other = header.magic and header.abi != h.ABI
        hint = "use the same version of shmgen on both sides" if other else clean
        yield Problem(region.topic, why, hint, file)


def _layout(region: Evidence) -> Iterator[Problem]:
    header, file, expected, layout = region.after, region_file(region.name), region.expected, region.layout
    package, _, bare = header.type_name.partition("/")
    if expected.type and expected.type not in (header.type_name, f"{package}/{bare.rpartition('/')[2]}"):
        message = f"the region has type {header.type_name}, but shmgen.toml has {expected.type}"
        yield Problem(region.topic, message, _ADVICE_CLEAN.format(topic=region.topic), file)
    elif layout and (layout.digest, layout.size) != (header.digest, header.payload_size):
        message = (
            f"the region has another layout of {header.type_name} than this folder: "
            f"digest 16#{header.digest:016X}, {counted(header.payload_size, 'byte')} in the region; {layout}"
        )
        hint = "run `shmgen generate` and rebuild both sides; " + _ADVICE_CLEAN.format(topic=region.topic)
        yield Problem(region.topic, message, hint, file)
    elif expected.depth and (slots := abi.slots_for(expected.depth)) != header.slots:
        message = f"the region has {header.slots} slots, but depth = {expected.depth} in shmgen.toml needs {slots}"
        hint = "configure the same depth on both sides; " + _ADVICE_CLEAN.format(topic=region.topic)
        yield Problem(region.topic, message, hint, file)


def _semaphore(region: Evidence) -> Iterator[Problem]:
    if region.expected.regions.sync == "sequence":
        return
    before, now = region.semaphores
    file = semaphore_file(region.name)
    if now is None:
        peers = [peer.pid for peer in region.peers]
        message = "its semaphore is missing" + (", so running processes no longer exclude each other" if peers else "")
        hint = (
            f"restart {', '.join(f'process {pid}' for pid in peers)}"
            if peers
            else "the next publisher or subscriber creates a new one"
        )
        yield Problem(region.topic, message, hint, file, note=not peers)
    elif stat.S_ISREG(now.status.st_mode) and now.status.st_size not in SIZES:
        size = counted(now.status.st_size, "byte")
        message = f"the file of its semaphore has {size} instead of 32, or 16 for 32-bit processes"
        yield Problem(region.topic, message, _ADVICE_CLEAN.format(topic=region.topic), file)
    elif before and min(before.value or 0, now.value or 0) > 1:
        message = f"the value of its semaphore is {now.value}, so {now.value} processes can hold the lock at once"
        hint = "it returns to 1 automatically: each Python publish or read removes up to 64"
        yield Problem(region.topic, message, hint, file)


def _lock(region: Evidence) -> Iterator[Problem]:
    before, now = region.semaphores
    stuck = before and now and before.value == 0 and now.value == 0
    if not stuck or region.before.lock_count != region.after.lock_count:
        return
    holder = region.after.lock_holder
    if holder == 0:
        who = "a process that does not follow the protocol"
    elif holder == h.PLC:
        who = "a PLC"
    else:
        who = f"process {holder} ({called(holder)})" if alive(holder) else f"process {holder}, which is dead,"
    message = f"its lock has been held by {who} for {region.seconds:.1f} s"
    hint = (
        f"the next publisher or subscriber recovers the lock within 1.2 s; otherwise run `shmgen clean {region.topic}`"
    )
    pid = holder if holder not in (0, h.PLC) else None
    yield Problem(region.topic, message, hint, semaphore_file(region.name), pid)


def _bitness(region: Evidence) -> Iterator[Problem]:
    lock = region.semaphores[1]
    maker = lock.bits if lock else None
    kinds = {peer.bits for peer in region.peers if peer.bits} | ({maker} if maker and region.peers else set())
    if len(kinds) > 1 and region.expected.regions.sync != "sequence":
        peers_with_bits = ", ".join(f"{peer} has {peer.bits} bits" for peer in region.peers if peer.bits)
        message = (
            f"programs of 32 and 64 bits cannot share a semaphore: {peers_with_bits}; a {maker}-bit process created it"
        )
        hint = 'write sync = "sequence" under [regions] in shmgen.toml, and generate both sides again'
        if not (IN_C or has_barrier()):
            hint = (
                f'run only 32-bit or only 64-bit programs: sync = "sequence" is not supported on {os.uname().machine}'
            )
        odd = next((peer.pid for peer in region.peers if peer.bits == 32), None)
        yield Problem(region.topic, message, hint, semaphore_file(region.name), odd)
