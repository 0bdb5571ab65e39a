"""Turns a status of the C headers into a typed error that says where, why and what to do next."""

from __future__ import annotations

import errno
import os
from contextlib import suppress
from enum import IntEnum
from typing import NoReturn

from shmgen.runtime.errors import (
    ClaimLost,
    Closed,
    InForkedChild,
    LockTimeout,
    PermissionDenied,
    RegionInUse,
    RegionMissing,
    RegionUnusable,
    ShmError,
)
from shmgen.runtime.region.access import access_for, denied, opened
from shmgen.runtime.region.looks import (
    check_header,
    check_semaphore,
    need_glibc,
    opened_to_read,
    peek,
    refused_by_system,
    restless,
    writer_of,
)
from shmgen.runtime.region.names import event_name, region_file, region_name, semaphore_file
from shmgen.runtime.region.settings import Settings


class Status(IntEnum):
    """Of shmgen_status.h, those that are more than a file one can look at."""

    REGION_NO_ACCESS = 10
    RESTLESS = 15
    SEMAPHORE_NO_ACCESS = 30
    LOCK_TIMEOUT = 33
    WRITER_IN_USE = 40
    CLAIM_LOST = 41
    OPENING = 102
    CLOSED = 103
    IN_FORKED_CHILD = 104
    REGION_MISSING = 105


def refusal(of: Settings, status: int, pid: int, number: int) -> ShmError:
    """The error to raise; `pid` is that of the process that opened the end, `number` an errno."""
    try:
        _raise(of, status, pid, number)
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


def in_use(topic: str, who: str) -> RegionInUse:
    """What to say to a second writer."""
    return RegionInUse(f"{topic}: {who} publishes already; one writer a topic: stop that one first")


def claim_lost(topic: str, who: str) -> ClaimLost:
    """What to say to a writer whose topic another has taken over."""
    return ClaimLost(f"{topic}: {who} has taken the topic over; nothing was published")


def lock_timeout(topic: str, holder: int) -> LockTimeout:
    """What to say where the lock is needed and was not free."""
    return LockTimeout(
        f"{topic}: the lock was not free in time, held by process {holder}; nothing was published. See `shmgen doctor`"
    )


def _raise(of: Settings, status: int, pid: int, number: int) -> NoReturn:
    name = region_name(of.topic)
    path = region_file(name)
    if status in (Status.OPENING, Status.CLOSED, Status.IN_FORKED_CHILD):
        raise gone(of, status, pid)
    if status == Status.REGION_MISSING:
        raise RegionMissing(f"{path} does not exist: start a publisher or a subscriber of it")
    if status in (Status.WRITER_IN_USE, Status.CLAIM_LOST, Status.LOCK_TIMEOUT):
        _raise_of_peer(of, status, name)
    if status == Status.RESTLESS and number not in (errno.EMFILE, errno.ENFILE):
        raise restless(path)
    if not of.sequence:
        need_glibc(of.topic)
    for file in (path, semaphore_file(name), semaphore_file(event_name(name))):
        with suppress(FileNotFoundError):
            _look(of, file, is_region=file == path)
    if status in (Status.REGION_NO_ACCESS, Status.SEMAPHORE_NO_ACCESS):
        raise denied(path)
    if number:
        refused_by_system(path, number, of.header.size)
    raise RegionUnusable(f"{path} was changed while it was opened (status {status}); try again")


def _raise_of_peer(of: Settings, status: int, name: str) -> NoReturn:
    who, holder = "another process", 0
    with suppress(ShmError), opened_to_read(name) as file:
        header = peek(file.fileno())
        who, holder = writer_of(of.topic, file.fileno(), header.writer), header.lock_holder
    if status == Status.CLAIM_LOST:
        raise claim_lost(of.topic, who)
    if status == Status.WRITER_IN_USE:
        raise in_use(of.topic, who)
    raise lock_timeout(of.topic, holder)


def _look(of: Settings, path: str, is_region: bool) -> None:
    """As who opens it looks at a file; raises what there is to say of it, or FileNotFoundError."""
    access = access_for(of.options)
    try:
        file = opened(path, os.O_RDONLY if of.passive else os.O_RDWR)
    except PermissionError:
        raise denied(path) from None
    with file:
        if not of.passive:
            access.mend(file.fileno(), path)
            if objection := access.objection(os.fstat(file.fileno()), path):
                who, leave = objection
                raise PermissionDenied(f"{path}: {who}, and is not used\n  hint: {leave}")
        if is_region:
            check_header(of.topic, of.header, file)
        else:
            check_semaphore(file.fileno(), path)
