"""Turns messages into samples in shared memory and back: what generated Python imports (stdlib and posix_ipc only)."""

from __future__ import annotations

from shmgen.runtime import values
from shmgen.runtime.cutting import CuttingMessage
from shmgen.runtime.errors import (
    CountExceeded,
    LayoutMismatch,
    LockTimeout,
    OutOfRange,
    PermissionDenied,
    RegionInUse,
    RegionMissing,
    RegionUnusable,
    ShmError,
    StringTooLong,
    ValueRejected,
)
from shmgen.runtime.fields import Clock, Clocks, Elements, Text, Texts
from shmgen.runtime.header import Header
from shmgen.runtime.message import LATE_FROM, Late, Message
from shmgen.runtime.names import region_name
from shmgen.runtime.publisher import Publisher
from shmgen.runtime.region import read_header
from shmgen.runtime.subscriber import Subscriber
from shmgen.runtime.times import Duration, Time

__all__ = [
    "LATE_FROM",
    "Clock",
    "Clocks",
    "CountExceeded",
    "CuttingMessage",
    "Duration",
    "Elements",
    "Header",
    "Late",
    "LayoutMismatch",
    "LockTimeout",
    "Message",
    "OutOfRange",
    "PermissionDenied",
    "Publisher",
    "RegionInUse",
    "RegionMissing",
    "RegionUnusable",
    "ShmError",
    "StringTooLong",
    "Subscriber",
    "Text",
    "Texts",
    "Time",
    "ValueRejected",
    "read_header",
    "region_name",
    "values",
]
