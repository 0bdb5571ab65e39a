"""The layout of a region as data (ABI 2): each field of its header and of a slot's header, and all shared numbers.

The runtime, `shmgen.h`, `ST_ShmHeader`, `ST_ShmSlot`, `GVL_Shm` and the tables of docs/protocol.md are generated from
this module. No other file contains the offset of a header field. A new counter is one line in HEADER.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from typing import NamedTuple

# --- Numbers ------------------------------------------------------------------------------------------

MAGIC = 0x474D4853
ABI = 2
HEADER_SIZE = 192
SLOT_HEADER = 16
SLOT_STEP = 64
LANES = 2
PAGE = 4096
PLC = 0xFFFFFFFF
LAST = 0xFFFFFFFF
RESTART_GAP = 0x80000000
FORGET = 0x10000000
LEFT_OUT = 2
MAX_DEPTH = 65535
MAX_TYPE_NAME = 95
EVENT = "-event"
"""Suffix of the name of a region's event; the name of a topic contains no `-`."""
MAX_NAME = 80 - len(EVENT)
MAX_CALL_NAME = MAX_NAME - len("-response")
WRITER_LOCK = 0
REPAIR_LOCK = 1
READER_LOCK = 2

RETRY_MS = 500
CLAIM_MS = 1000
CONFIRM_MS = 100
RECOVER_MS = 1000
DEAD_MS = 50
LOCK_MS = 10
WAKE_MS = 10
POLL_MS = 1
HEARTBEAT_MS = 50
PEER_MS = 100
REMOVED_MS = 100


class Number(NamedTuple):
    """A constant of the protocol. `st` is its type in Structured Text, or `""` if no PLC needs the constant."""

    name: str
    value: int
    st: str
    meaning: str


NUMBERS = (
    Number("MAGIC", MAGIC, "DWORD", "'SHMG', marks a region"),
    Number("ABI", ABI, "UINT", "version of the protocol"),
    Number("HEADER_SIZE", HEADER_SIZE, "UINT", "header size in bytes"),
    Number("SLOT_HEADER", SLOT_HEADER, "UDINT", "slot header size in bytes"),
    Number("SLOT_STEP", SLOT_STEP, "UDINT", f"slot sizes are multiples of {SLOT_STEP} bytes"),
    Number("LANES", LANES, "UDINT", "number of lanes in a region"),
    Number("PAGE", PAGE, "UDINT", f"region sizes are multiples of {PAGE} bytes"),
    Number("PLC", PLC, "UDINT", "substitute for a PLC's process id"),
    Number("LAST", LAST, "UDINT", "largest sample number"),
    Number(
        "RESTART_GAP",
        RESTART_GAP,
        "UDINT",
        "if a sample's number is at least this far after the last read number, the writer restarted its numbers",
    ),
    Number(
        "FORGET",
        FORGET,
        "UDINT",
        "after this many samples, a writer clears the other lane's old number, before it compares as later",
    ),
    Number("LEFT_OUT", LEFT_OUT, "UDINT", "a takeover skips at most this many sample numbers"),
    Number("MAX_DEPTH", MAX_DEPTH, "UDINT", "largest depth, in samples"),
    Number("MAX_TYPE_NAME", MAX_TYPE_NAME, "UDINT", "longest type name in bytes, without terminating 0"),
    Number("MAX_NAME", MAX_NAME, "UDINT", "longest region name, in bytes"),
    Number(
        "MAX_CALL_NAME",
        MAX_CALL_NAME,
        "",
        "longest service or action name, in bytes",
    ),
    Number("WRITER_LOCK", WRITER_LOCK, "", "byte of the writer's record lock"),
    Number(
        "REPAIR_LOCK",
        REPAIR_LOCK,
        "",
        "byte of the record lock for creation, lock recovery and removal",
    ),
    Number("READER_LOCK", READER_LOCK, "", "byte of the readers' shared record lock"),
    Number("RETRY_MS", RETRY_MS, "UDINT", "interval at which a PLC retries to open a region"),
    Number("CLAIM_MS", CLAIM_MS, "UDINT", "a writer whose heartbeat is unchanged for this long counts as dead"),
    Number(
        "CONFIRM_MS",
        CONFIRM_MS,
        "UDINT",
        "time for which a new writer's id must stay unchanged",
    ),
    Number("RECOVER_MS", RECOVER_MS, "UDINT", "a lock with an unchanged holder is stuck after this time"),
    Number("DEAD_MS", DEAD_MS, "", "a lock whose holder no longer exists is stuck after this time"),
    Number("LOCK_MS", LOCK_MS, "", "default timeout for the lock"),
    Number("WAKE_MS", WAKE_MS, "", "longest single sleep of a waiting reader"),
    Number("POLL_MS", POLL_MS, "", "interval of a polling reader"),
    Number("HEARTBEAT_MS", HEARTBEAT_MS, "", "longest interval between two heartbeats of a waiting server"),
    Number("PEER_MS", PEER_MS, "", "time that other endpoints give a creator to set the file's size and group"),
    Number("REMOVED_MS", REMOVED_MS, "", "interval at which processes check whether their region was removed"),
)
"""The constants of the protocol. Constants whose names end with _MS are in milliseconds."""


# --- Header fields --------------------------------------------------------------------------------------------

SIZES = {"u8": 1, "char": 1, "u16": 2, "u32": 4, "u64": 8}

CREATOR = "creator"
"""The program or PLC that creates the region: the first one that finds no magic number in the region's header."""


class HeaderField(NamedTuple):
    """A field of a region's header or of a slot's header. `offset` is its position in this header in bytes.

    `type` is a name in SIZES, or an array such as `char[96]`. `st` is the field's name in Structured Text; its prefix
    gives the type there. `by` is the program that writes the field, such as `writer`, or `""` for a reserved field.
    """

    offset: int
    type: str
    name: str
    st: str
    by: str
    meaning: str

    @property
    def element(self) -> str:
        """The type of one element, a name in SIZES."""
        return self.type.partition("[")[0]

    @property
    def length(self) -> int:
        """The number of elements, 1 for a field that is not an array."""
        return int(self.type.partition("[")[2].removesuffix("]") or 1)

    @property
    def size(self) -> int:
        """The size of the field in bytes."""
        return SIZES[self.element] * self.length


_PLC = f"16#{PLC:08X} = a PLC"
HEADER = (
    HeaderField(
        0,
        "u32",
        "magic",
        "dwMagic",
        CREATOR,
        f"16#{MAGIC:08X} ('SHMG'), written last; 0 = header incomplete",
    ),
    HeaderField(4, "u16", "abi", "uiAbi", CREATOR, f"version of the protocol: {ABI}"),
    HeaderField(6, "u16", "header_size", "uiHeaderSize", CREATOR, f"size of this header: {HEADER_SIZE} bytes"),
    HeaderField(8, "u64", "digest", "lwDigest", CREATOR, "layout digest of the message"),
    HeaderField(16, "u32", "payload_size", "udiPayloadSize", CREATOR, "size of one message in bytes"),
    HeaderField(
        20,
        "u32",
        "slot_size",
        "udiSlotSize",
        CREATOR,
        f"slot size: {SLOT_HEADER} + payload_size, rounded up to a multiple of {SLOT_STEP} bytes",
    ),
    HeaderField(24, "u32", "writer", "udiWriter", "writer", f"writer's process id; {_PLC}, 0 = no writer"),
    HeaderField(28, "u32", "slots", "udiSlots", CREATOR, "slots in each lane: a power of two, at least 2"),
    HeaderField(
        32,
        f"char[{MAX_TYPE_NAME + 1}]",
        "type_name",
        "abyTypeName",
        CREATOR,
        "message type, such as 'geometry_msgs/msg/Pose'; unused bytes are 0",
    ),
    HeaderField(
        128,
        "u32",
        "completed0",
        "udiCompleted0",
        "writer",
        "number of the newest sample in lane 0, 0 = none",
    ),
    HeaderField(
        132,
        "u32",
        "completed1",
        "udiCompleted1",
        "writer",
        "number of the newest sample in lane 1, 0 = none",
    ),
    HeaderField(
        136,
        "u32",
        "turn",
        "udiTurn",
        "writer",
        "changes at each takeover; bit 0 = takeover in progress; bit 1 = the writer's lane",
    ),
    HeaderField(
        140,
        "u32",
        "left",
        "udiLeft",
        "writer",
        "all samples of the current writer have numbers later than this one; 0 = not set",
    ),
    HeaderField(
        144,
        "u32",
        "retired",
        "udiRetired",
        "remover",
        "1 = region removed or replaced: each endpoint closes it",
    ),
    HeaderField(
        148,
        "u32",
        "ordered",
        "udiOrdered",
        "each process on x86",
        "1 = on this CPU (x86), access is safe without the lock",
    ),
    HeaderField(
        152,
        "u32",
        "heartbeat",
        "udiHeartbeat",
        "writer",
        "counter that a running writer increments, also without samples",
    ),
    HeaderField(
        156, "u32", "lock_holder", "udiLockHolder", "lock holder", f"lock holder's process id; {_PLC}, 0 = free"
    ),
    HeaderField(160, "u32", "recoveries", "udiRecoveries", "recoverer", "number of recoveries of a stuck lock"),
    HeaderField(
        164,
        "u32",
        "armed",
        "udiArmed",
        "a waiting reader",
        "1 = a reader waits; a writer that wakes the readers stores 0",
    ),
    HeaderField(168, "u32", "lock_count", "udiLockCount", "lock holder", "number of acquisitions of the lock"),
    HeaderField(172, "u32", "missed", "udiMissed", "readers", "sum of all readers' missed samples, shown by tools"),
    HeaderField(176, "u32", "bell", "udiBell", "writer", "number of the sample for which the writer last woke readers"),
)

SLOT = (
    HeaderField(0, "u64", "stamp_ns", "lwStamp", "writer", "the writer's wall clock in ns since 1970, 0 = unknown"),
    HeaderField(8, "u32", "number", "udiNumber", "writer", "number of the sample; 0 = the sample is incomplete"),
)


def with_reserved(words: Iterable[HeaderField], size: int) -> Iterator[HeaderField]:
    """Yield the fields, and a reserved field for each gap between them, so that all fields fill `size` bytes.

    Raises ValueError if two fields overlap, a field is misaligned, or the fields need more than `size` bytes.
    """
    end = 0
    for word in (*words, HeaderField(size, "u8[0]", "", "", "", "")):
        if word.offset < end or word.offset % SIZES[word.element]:
            raise ValueError(f"{word.name or 'the end'} at {word.offset} is misaligned or lies before byte {end}")
        if word.offset > end:
            yield HeaderField(end, f"u8[{word.offset - end}]", f"reserved{end}", f"abyReserved{end}", "", "0")
        if word.offset < size:
            yield word
        end = word.offset + word.size


# --- Sizes --------------------------------------------------------------------------------------------


def slots_for(depth: int) -> int:
    """Return the number of slots for a depth: the smallest power of two that is larger than `depth`.

    A sample then stays readable until more than `depth` newer samples have been written.

    Raises ValueError for a depth outside 1 .. MAX_DEPTH.
    """
    if not 1 <= depth <= MAX_DEPTH:
        raise ValueError(f"depth is {depth}, but must be from 1 to {MAX_DEPTH} samples")
    return 1 << depth.bit_length()


def slot_size(payload: int) -> int:
    """Return the size of a slot in bytes, for a payload of `payload` bytes."""
    return _round_up(SLOT_HEADER + payload, SLOT_STEP)


def region_size(payload: int, slots: int = slots_for(1)) -> int:
    """Return the size of a region in bytes: its header and two lanes of `slots` slots, rounded up to whole pages.

    The default of `slots` is that of depth 1. Whole pages are necessary because some runtimes round sizes up to pages,
    and others compare sizes exactly.
    """
    return _round_up(HEADER_SIZE + LANES * slots * slot_size(payload), PAGE)


def _round_up(size: int, step: int) -> int:
    return -(-size // step) * step
