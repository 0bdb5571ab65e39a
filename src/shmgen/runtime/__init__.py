"""The library that generated Python classes import to exchange messages through shared memory.

The library needs the standard library and posix_ipc only.
"""

from __future__ import annotations

from shmgen.runtime import cpython as cpython  # first: the other imports fail without CPython
from shmgen.runtime.action_client import ActionClient
from shmgen.runtime.action_server import ActionServer, ServedGoal
from shmgen.runtime.client import ServiceClient
from shmgen.runtime.errors import (
    CallFailed,
    CallTimeout,
    ClaimLost,
    Closed,
    CountExceeded,
    InForkedChild,
    LayoutMismatch,
    LockTimeout,
    NoServer,
    OutOfRange,
    Overwritten,
    PermissionDenied,
    Reentered,
    RegionInUse,
    RegionMissing,
    RegionRetired,
    RegionUnusable,
    ShmError,
    StringTooLong,
    ValueRejected,
)
from shmgen.runtime.messages.message import Message
from shmgen.runtime.messages.times import Duration, Time
from shmgen.runtime.publisher import Publisher
from shmgen.runtime.region.access import RegionOptions
from shmgen.runtime.region.checks import read_header
from shmgen.runtime.region.header import Header
from shmgen.runtime.region.names import region_name
from shmgen.runtime.server import Call, ServiceServer
from shmgen.runtime.subscriber import Sample, Subscriber
from shmgen.runtime.wait_any import Notifier, can_wait_for_many, open_all, ready_any

__all__ = [
    "ActionClient",
    "ActionServer",
    "Call",
    "CallFailed",
    "CallTimeout",
    "ClaimLost",
    "Closed",
    "CountExceeded",
    "Duration",
    "Header",
    "InForkedChild",
    "LayoutMismatch",
    "LockTimeout",
    "Message",
    "NoServer",
    "Notifier",
    "OutOfRange",
    "Overwritten",
    "PermissionDenied",
    "Publisher",
    "Reentered",
    "RegionInUse",
    "RegionMissing",
    "RegionOptions",
    "RegionRetired",
    "RegionUnusable",
    "Sample",
    "ServedGoal",
    "ServiceClient",
    "ServiceServer",
    "ShmError",
    "StringTooLong",
    "Subscriber",
    "Time",
    "ValueRejected",
    "can_wait_for_many",
    "open_all",
    "read_header",
    "ready_any",
    "region_name",
]
