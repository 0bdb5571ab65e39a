"""The typed error for a status of the C headers: where, why and what to do next."""

from __future__ import annotations

import time
from contextlib import suppress
from enum import IntEnum

from shmgen.core import abi
from shmgen.runtime.errors import (
    ClaimLost,
    Closed,
    InForkedChild,
    LockTimeout,
    Reentered,
    RegionRetired,
    RegionUnusable,
    ShmError,
)
from shmgen.runtime.region.looks import in_use, opened_to_read, peek, refused_by_system, restless, writer_of
from shmgen.runtime.region.names import region_file, region_name
from shmgen.runtime.region.settings import Settings


class Status(IntEnum):
    """Of shmgen_status.h, those of an end that cannot be opened for more reasons than its files, or that was open."""

    RESTLESS = 15
    REGION_RETIRED = 17
    LOCK_TIMEOUT = 33
    WRITER_IN_USE = 40
    CLAIM_LOST = 41
    OPENING = 102
    CLOSED = 103
    IN_FORKED_CHILD = 104
    MISUSED = 106


def refusal(of: Settings, status: int, pid: int, number: int) -> ShmError:
    """The error to raise; `pid` is that of the process that opened the end, `number` an errno."""
    match status:
        case Status.MISUSED:
            return borrowed_already(of)
        case Status.OPENING | Status.CLOSED | Status.IN_FORKED_CHILD:
            return gone(of, status, pid)
        case Status.REGION_RETIRED:
            return retired(of)
        case Status.WRITER_IN_USE | Status.CLAIM_LOST | Status.LOCK_TIMEOUT:
            return _of_peer(of, status)
    try:
        _open_again(of)
        path = region_file(region_name(of.topic))
        if status == Status.RESTLESS:
            return restless(path)
        if number:
            refused_by_system(path, number, of.header.size)
        return RegionUnusable(f"{path} was changed while it was opened (status {status}); try again")
    except ShmError as error:
        return error


def gone(of: Settings, status: int, pid: int) -> ShmError:
    """What to say of an end that is not open."""
    if status == Status.IN_FORKED_CHILD:
        return InForkedChild(
            f"{of.topic}: this {of.word} belongs to process {pid}, from which this one was forked; "
            "open one here, or start processes by the method `spawn`"
        )
    return Closed(f"{of.topic}: this {of.word} is {'not open yet' if status == Status.OPENING else 'closed'}")


def retired(of: Settings) -> RegionRetired:
    """What to say of an end whose region has lost its name."""
    return RegionRetired(
        f"{of.topic}: the region was removed, or replaced by one of another layout: open this {of.word} anew, from "
        "what is generated now"
    )


def borrowed_already(of: Settings) -> Reentered:
    """What to say to who borrows twice."""
    return Reentered(f"{of.topic}: this {of.word} has lent a sample already: leave that `with` first")


def claim_lost(topic: str, who: str) -> ClaimLost:
    """What to say to a writer whose topic another has taken over."""
    return ClaimLost(f"{topic}: {who} has taken the topic over; nothing was published")


def lock_timeout(topic: str, holder: int) -> LockTimeout:
    """What to say where the lock is needed and was not free."""
    return LockTimeout(
        f"{topic}: the lock was not free in time, held by process {holder}; nothing was published. See `shmgen doctor`"
    )


def _of_peer(of: Settings, status: int) -> ShmError:
    who, holder = "another process", 0
    with suppress(ShmError), opened_to_read(region_name(of.topic)) as file:
        header = peek(file.fileno())
        who, holder = writer_of(of.topic, file.fileno(), header.writer), header.lock_holder
    if status == Status.LOCK_TIMEOUT:
        return lock_timeout(of.topic, holder)
    return claim_lost(of.topic, who) if status == Status.CLAIM_LOST else in_use(of.topic, who)


def _open_again(of: Settings) -> None:
    """As the reference in Python opens the same files, which says in words what C says by a number."""
    from shmgen.runtime.reference.opening import look_at  # loaded where something is wrong only

    for _ in look_at(of):
        time.sleep(abi.POLL_MS / 1000)
