"""The region as data (ABI 2): every word of its header and of a slot's, and every number both sides must know.

The runtime, `shmgen.h`, `ST_ShmHeader`, `ST_ShmSlot`, `GVL_Shm` and the tables of docs/protocol.md are made from here;
no other file says where a word stands. A new counter is one line in HEADER, where bytes are free.
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
"""What the name of the event has behind that of its region; `-` stands in no topic."""
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


class Number(NamedTuple):
    """`st` is its type in Structured Text, empty if no PLC needs it."""

    name: str
    value: int
    st: str
    meaning: str


NUMBERS = (
    Number("MAGIC", MAGIC, "DWORD", "'SHMG': this is a region"),
    Number("ABI", ABI, "UINT", "version of the protocol"),
    Number("HEADER_SIZE", HEADER_SIZE, "UINT", "bytes before slot 0"),
    Number("SLOT_HEADER", SLOT_HEADER, "UDINT", "bytes before the payload of a slot"),
    Number("SLOT_STEP", SLOT_STEP, "UDINT", "bytes; the size of a slot is a multiple of it"),
    Number("LANES", LANES, "UDINT", "rows of slots; a writer uses one of them"),
    Number("PAGE", PAGE, "UDINT", "bytes; the size of a region is a multiple of it"),
    Number("PLC", PLC, "UDINT", "in place of a process id, which a PLC does not know"),
    Number("LAST", LAST, "UDINT", "the greatest number of a sample; then it wraps around to the number of slots"),
    Number("RESTART_GAP", RESTART_GAP, "UDINT", "samples; so many cannot be missed: the numbers have started again"),
    Number(
        "FORGET", FORGET, "UDINT", "each so many samples a writer clears the numbers of others, before these look new"
    ),
    Number("LEFT_OUT", LEFT_OUT, "UDINT", "numbers that are left out at most where a writer takes over"),
    Number("MAX_DEPTH", MAX_DEPTH, "UDINT", "samples a slow reader can still fetch"),
    Number("MAX_TYPE_NAME", MAX_TYPE_NAME, "UDINT", "bytes of a type's name, before the 0 that ends it"),
    Number("MAX_NAME", MAX_NAME, "UDINT", "characters of a region's name: STRING(80) less '-event'"),
    Number("MAX_CALL_NAME", MAX_CALL_NAME, "", "characters of a service or an action: MAX_NAME less '-response'"),
    Number("WRITER_LOCK", WRITER_LOCK, "", "the byte under a record lock while a writer has the region open"),
    Number(
        "REPAIR_LOCK",
        REPAIR_LOCK,
        "",
        "the byte under one while the header is written, the lock recovered, or the file removed",
    ),
    Number("READER_LOCK", READER_LOCK, "", "the byte under a shared one while a reader has the region open"),
    Number("RETRY_MS", RETRY_MS, "UDINT", "a PLC tries again to open what it could not open"),
    Number("CLAIM_MS", CLAIM_MS, "UDINT", "a writer whose heartbeat does not change for this long is gone"),
    Number("CONFIRM_MS", CONFIRM_MS, "UDINT", "an id in `writer` that is unchanged after this time is a claim"),
    Number("RECOVER_MS", RECOVER_MS, "UDINT", "a lock that nobody has acquired for this long is stuck"),
    Number("DEAD_MS", DEAD_MS, "", "the same, if its holder is a process that no longer exists"),
    Number("LOCK_MS", LOCK_MS, "", "timeout for the lock, by default"),
    Number("WAKE_MS", WAKE_MS, "", "the longest single sleep of who waits: what a lost wake-up costs"),
    Number("POLL_MS", POLL_MS, "", "between two looks where nobody would wake"),
    Number("HEARTBEAT_MS", HEARTBEAT_MS, "", "a waiting server increments its heartbeat at least this often"),
    Number("PEER_MS", PEER_MS, "", "a peer between two system calls has made the second by then, or is dead"),
)
"""Names end with _MS where they are milliseconds."""


# --- Words --------------------------------------------------------------------------------------------

SIZES = {"u8": 1, "char": 1, "u16": 2, "u32": 4, "u64": 8}

CREATOR = "creator"
"""Who writes the words that both sides must agree on: whoever finds no magic, in Python or in a PLC."""


class Word(NamedTuple):
    """`offset` in bytes; `type` is a name in SIZES, or several of it: `char[96]`. `st` is its name in Structured Text,
    whose prefix says the type there. `by` is who writes it; nobody writes what is reserved.
    """

    offset: int
    type: str
    name: str
    st: str
    by: str
    meaning: str

    @property
    def element(self) -> str:
        """What it is made of, a name in SIZES."""
        return self.type.partition("[")[0]

    @property
    def length(self) -> int:
        """How many of them: 1 unless it is an array."""
        return int(self.type.partition("[")[2].removesuffix("]") or 1)

    @property
    def size(self) -> int:
        """Bytes."""
        return SIZES[self.element] * self.length


_PLC = f"16#{PLC:08X} = a PLC"
HEADER = (
    Word(0, "u32", "magic", "dwMagic", CREATOR, f"16#{MAGIC:08X}, 'SHMG'; written last, 0 = being created"),
    Word(4, "u16", "abi", "uiAbi", CREATOR, f"{ABI}"),
    Word(6, "u16", "header_size", "uiHeaderSize", CREATOR, f"{HEADER_SIZE}"),
    Word(8, "u64", "digest", "lwDigest", CREATOR, "layout digest of the message"),
    Word(16, "u32", "payload_size", "udiPayloadSize", CREATOR, "bytes of one message"),
    Word(20, "u32", "slot_size", "udiSlotSize", CREATOR, f"{SLOT_HEADER} + payload_size, rounded up to {SLOT_STEP}"),
    Word(24, "u32", "writer", "udiWriter", "writer", f"process id; {_PLC}, 0 = none yet"),
    Word(28, "u32", "slots", "udiSlots", CREATOR, "a power of two, 2 at least"),
    Word(32, f"char[{MAX_TYPE_NAME + 1}]", "type_name", "abyTypeName", CREATOR, "'geometry_msgs/msg/Pose', the rest 0"),
    Word(
        128,
        "u32",
        "completed0",
        "udiCompleted0",
        "writer",
        "number of the newest sample completed in lane 0, 0 = none yet",
    ),
    Word(132, "u32", "completed1", "udiCompleted1", "writer", "the same of lane 1"),
    Word(136, "u32", "turn", "udiTurn", "writer", "its second bit is the lane; odd: a takeover has begun"),
    Word(140, "u32", "left", "udiLeft", "writer", "number that the writer began after; 0 = none left out"),
    Word(
        144, "u32", "retired", "udiRetired", "who removes it", "1 = the name leads elsewhere: let go, and open it anew"
    ),
    Word(
        148,
        "u32",
        "ordered",
        "udiOrdered",
        "whoever knows",
        "1 = stores and loads keep their order on this machine: x86",
    ),
    Word(152, "u32", "heartbeat", "udiHeartbeat", "writer", "incremented in each cycle, with or without data"),
    Word(156, "u32", "lock_holder", "udiLockHolder", "lock holder", f"process id; {_PLC}, 0 = nobody"),
    Word(160, "u32", "recoveries", "udiRecoveries", "whoever recovers", "how often a stuck lock was recovered"),
    Word(164, "u32", "armed", "udiArmed", "a waiting reader", "1 = a reader waits; the writer clears it and wakes"),
    Word(168, "u32", "lock_count", "udiLockCount", "lock holder", "incremented at each acquisition"),
    Word(172, "u32", "missed", "udiMissed", "readers", "samples that readers missed, for people to see"),
    Word(176, "u32", "bell", "udiBell", "writer", "number of the sample for which it has woken readers"),
)

SLOT = (
    Word(0, "u64", "stamp_ns", "lwStamp", "writer", "the writer's wall clock in ns since 1970, 0 = it has none"),
    Word(8, "u32", "number", "udiNumber", "writer", "number of the sample, 0 = it is not whole"),
)


def tiled(words: Iterable[Word], size: int) -> Iterator[Word]:
    """The words with the bytes between them, which are 0, as words of their own: `size` bytes without a gap.

    Raises ValueError if two overlap, one does not lie at a multiple of its own size, or there are more bytes.
    """
    end = 0
    for word in (*words, Word(size, "u8[0]", "", "", "", "")):
        if word.offset < end or word.offset % SIZES[word.element]:
            raise ValueError(f"{word.name or 'the end'} cannot lie at {word.offset}, {end} bytes are taken")
        if word.offset > end:
            yield Word(end, f"u8[{word.offset - end}]", f"reserved{end}", f"abyReserved{end}", "", "0")
        if word.offset < size:
            yield word
        end = word.offset + word.size


# --- Sizes --------------------------------------------------------------------------------------------


def slots_for(depth: int) -> int:
    """The power of two above `depth`, so that a sample stays while the next `depth` are written.

    Raises ValueError for a depth outside 1 .. MAX_DEPTH.
    """
    if not 1 <= depth <= MAX_DEPTH:
        raise ValueError(f"depth is {depth}; it goes from 1 to {MAX_DEPTH} samples")
    return 1 << depth.bit_length()


def slot_size(payload: int) -> int:
    """Bytes of a slot that holds `payload` bytes."""
    return _round_up(SLOT_HEADER + payload, SLOT_STEP)


def region_size(payload: int, slots: int) -> int:
    """Bytes of a region: header and two lanes of slots, in whole pages.

    So a runtime that compares sizes exactly and one that rounds them agree.
    """
    return _round_up(HEADER_SIZE + LANES * slots * slot_size(payload), PAGE)


def _round_up(size: int, step: int) -> int:
    return -(-size // step) * step
