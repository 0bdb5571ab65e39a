"""The problems that evidence about a region shows: what is wrong, which file, which process, what to do next."""

from __future__ import annotations

import os
import stat
from collections.abc import Iterator

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

_ADVICE_CLEAN = "stop both sides, `shmgen clean {topic}`, start them again"


def of_region(seen: Evidence) -> Iterator[Problem]:
    """All that is wrong with one region and its semaphore."""
    for check in (_header, _layout, permissions.of_files, _semaphore, _lock, _bitness):
        yield from check(seen)


def _header(seen: Evidence) -> Iterator[Problem]:
    header, file = seen.after, region_file(seen.name)
    if why := damage(header):
        clean = _ADVICE_CLEAN.format(topic=seen.topic)
        other = header.magic and header.abi != h.ABI
        hint = "use the same version of shmgen on both sides" if other else clean
        yield Problem(seen.topic, why, hint, file)


def _layout(seen: Evidence) -> Iterator[Problem]:
    header, file, wanted, layout = seen.after, region_file(seen.name), seen.wanted, seen.layout
    package, _, bare = header.type_name.partition("/")
    if wanted.type and wanted.type not in (header.type_name, f"{package}/{bare.rpartition('/')[2]}"):
        message = f"it holds {header.type_name}, and shmgen.toml says {wanted.type}"
        yield Problem(seen.topic, message, _ADVICE_CLEAN.format(topic=seen.topic), file)
    elif layout and (layout.digest, layout.size) != (header.digest, header.payload_size):
        message = (
            f"it has another layout of {header.type_name} than this folder: "
            f"digest 16#{header.digest:016X}, {counted(header.payload_size, 'byte')} there; {layout}"
        )
        hint = "`shmgen generate`, rebuild both sides; " + _ADVICE_CLEAN.format(topic=seen.topic)
        yield Problem(seen.topic, message, hint, file)
    elif wanted.depth and (slots := 1 << wanted.depth.bit_length()) != header.slots:
        message = f"it has {header.slots} slots, and depth = {wanted.depth} in shmgen.toml takes {slots}"
        hint = "give both sides the same depth; " + _ADVICE_CLEAN.format(topic=seen.topic)
        yield Problem(seen.topic, message, hint, file)


def _semaphore(seen: Evidence) -> Iterator[Problem]:
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
        yield Problem(seen.topic, message, hint, file, note=not peers)
    elif stat.S_ISREG(now.status.st_mode) and now.status.st_size not in SIZES:
        held = counted(now.status.st_size, "byte")
        message = f"its semaphore's file has {held}, and a semaphore has 32 (of 32-bit processes 16)"
        yield Problem(seen.topic, message, _ADVICE_CLEAN.format(topic=seen.topic), file)
    elif before and min(before.value or 0, now.value or 0) > 1:
        message = f"its semaphore is {now.value}: that many processes can hold the lock at once"
        hint = "it returns to 1 automatically: each Python publish or read removes up to 64"
        yield Problem(seen.topic, message, hint, file)


def _lock(seen: Evidence) -> Iterator[Problem]:
    before, now = seen.semaphores
    stuck = before and now and before.value == 0 and now.value == 0
    if not stuck or seen.before.lock_count != seen.after.lock_count:
        return
    holder = seen.after.lock_holder
    if holder == 0:
        who = "nobody that follows the protocol"
    elif holder == h.PLC:
        who = "a PLC"
    else:
        who = f"process {holder} ({called(holder)})" if alive(holder) else f"process {holder}, which is dead"
    message = f"its lock is held by {who}, and has not been released for {seen.seconds:.1f} s"
    hint = f"the next publisher or subscriber frees it within 1.2 s; with none, `shmgen clean {seen.topic}`"
    pid = holder if holder not in (0, h.PLC) else None
    yield Problem(seen.topic, message, hint, semaphore_file(seen.name), pid)


def _bitness(seen: Evidence) -> Iterator[Problem]:
    lock = seen.semaphores[1]
    maker = lock.bits if lock else None
    kinds = {peer.bits for peer in seen.peers if peer.bits} | ({maker} if maker and seen.peers else set())
    if len(kinds) > 1 and seen.wanted.regions.sync != "sequence":
        shown = ", ".join(f"{peer} has {peer.bits} bits" for peer in seen.peers if peer.bits)
        message = f"a semaphore does not cross bitness: {shown}; the semaphore was made in a {maker}-bit process"
        hint = 'write sync = "sequence" under [regions] in shmgen.toml, and generate both sides again'
        if not (IN_C or has_barrier()):
            hint = f'run programs of one bitness on both sides: sync = "sequence" is refused on {os.uname().machine}'
        odd = next((peer.pid for peer in seen.peers if peer.bits == 32), None)
        yield Problem(seen.topic, message, hint, semaphore_file(seen.name), odd)
