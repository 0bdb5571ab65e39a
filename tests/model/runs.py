"""What spin goes through: small for each test run, large for `make model`, and faults planted in the protocol."""

from __future__ import annotations

from .spin import Run

_P = "START_P READS=1 PUBLISHES=1 CYCLES=3"
"""Python has published and been silent; a PLC takes over."""
_L = "START_L READS=1 PUBLISHES=1 CYCLES=2"
"""The other way round."""
_FRESH = "READS=1 PUBLISHES=1 CYCLES=4"

HOLDS = [
    Run("writers", f"{_P} STALLS=1"),
    Run("writers", f"{_L} STALLS=1"),
    Run("writers", f"{_L} STALLS=1 WRAP"),
    Run("writers", f"{_P} STALLS=0 CRASHES=1"),
    Run("writers", f"{_L} STALLS=0 CRASHES=1"),
    Run("writers", f"{_P} STALLS=1 NOLOCK"),
    Run("writers", f"{_FRESH} STALLS=1 NOLOCK CLOSES=1"),
    Run("writers", f"{_FRESH} STALLS=1"),
    Run("writers", f"{_L} STALLS=1 TSO"),
    Run("writers", f"{_P} STALLS=1 TSO NOLOCK"),
    Run("writers", f"{_P} STALLS=0 WEAK"),
    Run("writers", f"{_L} STALLS=0 CRASHES=1 WEAK"),
    Run("writers", f"{_P} STALLS=0 WEAK NOLOCK FENCES"),
    Run("writers", f"{_L} STALLS=0 WEAK NOLOCK FENCES"),
    Run("lock", "STALLS=0"),
    Run("lock", "STALLS=1 CRASHES=1 TRIES=1"),
    Run("lock", "STALLS=0 MAKES"),
    Run("lock", "FOREVER STALLS=0 CRASHES=1 WITHOUT_Q", for_ever=True),
    Run("lock", "FOREVER STALLS=1 CRASHES=0 WITHOUT_Q", for_ever=True),
    Run("wakeup"),
    Run("wakeup", "TSO"),
    Run("wakeup", "TSO TWO BOUND CRASHES=1"),
    Run("wakeup", "WEAK BOUND"),
    Run("header", "THREE"),
    Run("header", "TSO STALLS=1"),
    Run("header", "TSO DIFFERENT"),
    Run("services", "CLIENTS"),
    Run("services", "SERVERS"),
    Run("services", "STALLS=0 CRASHES=1 OPENS=2 CALLS=2"),
]
"""A minute on two processors. Nothing may be found."""

LARGE = [
    Run("writers", "START_P STALLS=1 READS=2 PUBLISHES=2 CYCLES=4"),
    Run("writers", "START_L STALLS=1 READS=2 PUBLISHES=2 CYCLES=3"),
    Run("writers", "START_P STALLS=1 READS=1 PUBLISHES=2 CYCLES=4 WRAP"),
    Run("writers", "START_L STALLS=1 CRASHES=1 READS=1 PUBLISHES=1 CYCLES=3"),
    Run("writers", "START_P STALLS=1 CRASHES=1 READS=1 PUBLISHES=1 CYCLES=3"),
    Run("writers", "START_P STALLS=1 READS=1 PUBLISHES=1 CYCLES=7 CLOSES=1 NOLOCK"),
    Run("writers", "STALLS=1 READS=1 PUBLISHES=2 CYCLES=4 CLOSES=1"),
    Run("writers", "START_L STALLS=1 READS=1 PUBLISHES=2 CYCLES=3 TSO"),
    Run("writers", "START_P STALLS=1 READS=1 PUBLISHES=1 CYCLES=4 TSO"),
    Run("writers", "START_P STALLS=0 READS=1 PUBLISHES=2 CYCLES=3 WEAK"),
    Run("writers", "START_L STALLS=0 CRASHES=1 READS=1 PUBLISHES=2 CYCLES=3 WEAK"),
    Run("writers", "START_P STALLS=1 READS=1 PUBLISHES=1 CYCLES=3 WEAK NOLOCK FENCES"),
    Run("writers", "START_L STALLS=0 CRASHES=1 READS=1 PUBLISHES=2 CYCLES=3 WEAK NOLOCK FENCES"),
    Run("lock", "STALLS=1"),
    Run("lock", "STALLS=0 CRASHES=1"),
    Run("lock", "STALLS=1 MAKES"),
    Run("wakeup", "WEAK TWO BOUND CRASHES=1"),
    Run("services", "CLIENTS OPENS=2"),
    Run("services", "SERVERS CALLS=3 TAKES=3"),
    Run("services", "STALLS=0 CRASHES=1 OPENS=2 CLIENTS"),
]
"""`make model` goes through these as well."""

FAULTS = [
    # The protocol as it was until 1.0 changed writers: two at once.
    Run("writers", f"{_P} STALLS=1 PUBLISHES=2 F_TODAY"),
    Run("writers", f"{_L} STALLS=1 F_TODAY"),
    # The mends one by one.
    Run("writers", f"{_L} STALLS=1 F_NO_LOOK"),
    Run("writers", f"{_L} STALLS=1 F_NO_VOID"),
    Run("writers", f"{_L} STALLS=1 F_NO_CONFIRM"),
    Run("writers", f"{_L} STALLS=1 F_NO_LEAP"),
    Run("writers", f"{_L} STALLS=1 F_NUMBER_NOT_FIRST"),
    Run("writers", f"{_L} STALLS=0 CRASHES=2 F_BEGUN_LEAPS"),
    Run("writers", f"{_L} STALLS=0 CRASHES=2 F_LEAPS_ALWAYS"),
    Run("writers", "START_P READS=1 PUBLISHES=1 CYCLES=6 STALLS=1 NOLOCK F_NUMBER_FROM_COMPLETED"),
    Run("writers", f"{_L} STALLS=1 F_NUMBER_BEFORE_COPY"),
    Run("writers", "START_L READS=1 PUBLISHES=2 CYCLES=3 STALLS=1 F_NUMBER_BEFORE_BEGUN"),
    Run("writers", f"{_L} STALLS=0 F_SHORT_WATCH"),
    Run("writers", "START_L READS=1 PUBLISHES=1 CYCLES=3 CLOSES=1 STALLS=1 F_CLOSE_ANY"),
    Run("writers", "START_P READS=1 PUBLISHES=2 CYCLES=0 STALLS=0 WEAK NOLOCK F_WITHOUT_LOCK"),
    Run("writers", "START_P READS=1 PUBLISHES=2 CYCLES=0 STALLS=0 WEAK NOLOCK FENCES F_NO_FENCE_P"),
    Run("writers", "START_L READS=1 PUBLISHES=0 CYCLES=2 STALLS=0 WEAK NOLOCK FENCES F_NO_FENCE_L"),
    Run("writers", "START_P READS=1 PUBLISHES=2 CYCLES=0 STALLS=0 WEAK NOLOCK FENCES F_NO_FENCE_R"),
    Run("lock", "STALLS=0 TRIES=3 F_COUNT_ONLY"),
    Run("lock", "STALLS=0 TRIES=3 F_HOLDER_FIRST"),
    Run("lock", "STALLS=0 TRIES=3 F_SPARSE"),
    Run("lock", "STALLS=0 MAKES F_NEW_NOT_COUNTED"),
    Run("lock", "FOREVER STALLS=0 CRASHES=1 WITHOUT_Q F_BY_COMPLETED", for_ever=True),
    Run("wakeup", "TSO F_NO_FENCE_WRITER"),
    Run("wakeup", "TSO F_NO_FENCE_READER"),
    Run("wakeup", "F_NO_SECOND_LOOK"),
    Run("wakeup", "F_NOT_ARMED"),
    Run("header", "F_MAGIC_FIRST"),
    Run("header", "DIFFERENT F_NO_SECOND_LOOK"),
    Run("services", "CLIENTS F_NO_LEAP"),
    Run("services", "SERVERS CALLS=2 F_TAKEN_UNLOOKED"),
    Run("services", "SERVERS CALLS=2 F_READ_NOT_SKIPPED"),
    Run("services", "SERVERS CALLS=2 F_SKIPS_ONCE"),
    Run("services", "CLIENTS F_ANY_REPLY"),
]
"""An error must be found in each."""

REMAINS = [
    # A writer that stood still inside its copy, while others read or write in just the rest of it.
    Run("writers", f"{_L} STALLS=1 WINDOW"),
    # The same on an ARM-like order, where two may be inside after a healing.
    Run("writers", f"{_P} STALLS=1 WEAK"),
    # A PLC of 32 bits that dies between two stores of its first write.
    Run("writers", "START_P READS=0 PUBLISHES=1 CYCLES=4 STALLS=0 CRASHES=2 NOLOCK F_PAIR_APART"),
    # A wake-up lost for one slice of 10 ms, and a header seen half made, where stores pass stores and loads.
    Run("wakeup", "WEAK"),
    Run("header", "WEAK"),
    # Three that make a region at once, one of another layout.
    Run("header", "DIFFERENT THREE"),
]
"""What docs/protocol.md says is not closed: spin finds it, and if it did not the page would be wrong."""
