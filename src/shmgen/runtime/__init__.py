"""What generated Python imports: messages as samples in shared memory (stdlib and posix_ipc only)."""

from __future__ import annotations

from shmgen.runtime import cpython as cpython  # before all that would fail elsewhere
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
from shmgen.runtime.messages import values
from shmgen.runtime.messages.fields import Clock, Clocks, Elements, Text, Texts
from shmgen.runtime.messages.message import LATE_FROM, Late, Message
from shmgen.runtime.messages.times import Duration, Time
from shmgen.runtime.publisher import Publisher
from shmgen.runtime.region.access import RegionOptions
from shmgen.runtime.region.header import Header
from shmgen.runtime.region.looks import read_header
from shmgen.runtime.region.names import region_name
from shmgen.runtime.sample import Sample
from shmgen.runtime.server import Call, ServiceServer
from shmgen.runtime.subscriber import Subscriber
from shmgen.runtime.wait_any import can_wait_for_many, open_all, ready_any

__all__ = [
    "LATE_FROM",
    "ActionClient",
    "ActionServer",
    "Call",
    "CallFailed",
    "CallTimeout",
    "ClaimLost",
    "Clock",
    "Clocks",
    "Closed",
    "CountExceeded",
    "Duration",
    "Elements",
    "Header",
    "InForkedChild",
    "Late",
    "LayoutMismatch",
    "LockTimeout",
    "Message",
    "NoServer",
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
    "Text",
    "Texts",
    "Time",
    "ValueRejected",
    "can_wait_for_many",
    "open_all",
    "read_header",
    "ready_any",
    "region_name",
    "values",
]
