"""Converts a status number of the C headers into a typed error with the place, the reason and the next step."""

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
from shmgen.runtime.region.checks import (
    file_vanishes_error,
    log_replaced,
    opened_to_read,
    raise_system_error,
    read_header_of,
    region_in_use_error,
)
from shmgen.runtime.region.names import region_file, region_name
from shmgen.runtime.region.record_locks import describe_writer
from shmgen.runtime.region.settings import Settings


class Status(IntEnum):
    """Status numbers of the C headers (shmgen_status.h) for which refusal() can create an error directly.

    For any other number, refusal() opens the files again in Python, which raises the typed error.
    """

    RESTLESS = 15
    REGION_RETIRED = 17
    DEPTH_MISMATCH = 24
    LOCK_TIMEOUT = 33
    WRITER_IN_USE = 40
    CLAIM_LOST = 41
    OPENING = 102
    CLOSED = 103
    IN_FORKED_CHILD = 104
    MISUSED = 106


def refusal(of: Settings, status: int, pid: int, number: int) -> ShmError:
    """Return the typed error for `status`, a status number of the C headers.

    `pid` is the process that opened the publisher or subscriber, and `number` is an errno or 0.
    """
    match status:
        case Status.MISUSED:
            return borrowed_already(of)
        case Status.OPENING | Status.CLOSED | Status.IN_FORKED_CHILD:
            return not_open_error(of, status, pid)
        case Status.REGION_RETIRED:
            return retired_error(of)
        case Status.WRITER_IN_USE | Status.CLAIM_LOST | Status.LOCK_TIMEOUT:
            return _of_peer(of, status)
    try:
        _open_again(of)
        path = region_file(region_name(of.topic))
        if status == Status.RESTLESS:
            return file_vanishes_error(path)
        if number:
            raise_system_error(path, number, of.header.size)
        return RegionUnusable(f"{path} was changed while it was opened (status {status}); try again")
    except ShmError as error:
        return error


def not_open_error(of: Settings, status: int, pid: int) -> ShmError:
    """Return the error for a call on a publisher or subscriber that is not open and that process `pid` has created."""
    if status == Status.IN_FORKED_CHILD:
        return InForkedChild(
            f"{of.topic}: this {of.word} was opened by process {pid} before a fork; "
            "open a new one in this process, or start processes with the method `spawn`"
        )
    return Closed(f"{of.topic}: this {of.word} is {'not open yet' if status == Status.OPENING else 'closed'}")


def retired_error(of: Settings) -> RegionRetired:
    """Return the error for a publisher or subscriber whose region was removed or replaced."""
    return RegionRetired(
        f"{of.topic}: the region was removed, or replaced by a region of another layout: generate both sides again, "
        f"and open a new {of.word}"
    )


def log_recreated(of: Settings, status: int) -> None:
    """Log that a publisher or subscriber has reopened or replaced its region.

    `status` is the reason: REGION_RETIRED if the region was removed, otherwise a mismatch of depth or layout.
    """
    if status != Status.REGION_RETIRED:
        log_replaced(of.topic, of.word, is_depth=status == Status.DEPTH_MISMATCH)
        return
    import logging  # takes longer to load than the rest of the runtime

    logging.getLogger("shmgen").warning(
        f"{of.topic}: {region_file(region_name(of.topic))} was removed; this {of.word} has reopened it. "
        "Causes: docs/troubleshooting.md"
    )


def borrowed_already(of: Settings) -> Reentered:
    """Return the error for a second borrow() while a sample is borrowed."""
    return Reentered(f"{of.topic}: a sample of this {of.word} is borrowed already: end that `with` block first")


def claim_lost(topic: str, who: str) -> ClaimLost:
    """Return the error for a writer whose topic was taken over. `who` describes the new writer."""
    return ClaimLost(f"{topic}: {who} has taken the topic over; nothing was published")


def lock_timeout(topic: str, holder: int) -> LockTimeout:
    """Return the error for a lock that was not free in time. `holder` is the id of the process that holds the lock."""
    return LockTimeout(
        f"{topic}: the lock was not free in time, held by process {holder}; nothing was published. See `shmgen doctor`"
    )


def _of_peer(of: Settings, status: int) -> ShmError:
    who, holder = "another process", 0
    with suppress(ShmError), opened_to_read(region_name(of.topic)) as file:
        header = read_header_of(file.fileno())
        who, holder = describe_writer(file.fileno(), header.writer), header.lock_holder
    if status == Status.LOCK_TIMEOUT:
        return lock_timeout(of.topic, holder)
    return claim_lost(of.topic, who) if status == Status.CLAIM_LOST else region_in_use_error(of.topic, who)


def _open_again(of: Settings) -> None:
    """Open the files of the topic with the engine in Python, which raises a typed error instead of a status number."""
    from shmgen.runtime.reference.opening import look_at  # loaded only after an error

    for _ in look_at(of):
        time.sleep(abi.POLL_MS / 1000)
