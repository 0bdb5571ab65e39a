"""What spin goes through: small for each test run, large for `make model`, and faults planted in the protocol."""

from __future__ import annotations

from .spin import Run

HOLDS = [
    Run("samples"),
    Run("samples", "WEAK"),
    Run("samples", "WEAK COPY_FIRST"),
    Run("bell"),
    Run("bell", "WEAK"),
    Run("lock", "STALLS=0"),
    Run("lock", "STALLS=1 CRASHES=1 TRIES=1"),
    Run("lock", "STALLS=0 MAKES"),
    Run("lock", "FOREVER STALLS=0 CRASHES=1 WITHOUT_Q", for_ever=True),
    Run("lock", "FOREVER STALLS=1 CRASHES=0 WITHOUT_Q", for_ever=True),
    Run("header", "THREE"),
    Run("header", "TSO STALLS=1"),
    Run("header", "TSO DIFFERENT"),
]
"""Nothing may be found."""

LARGE = [
    Run("samples", "WEAK SAMPLES=6 READS=3"),
    Run("bell", "WEAK SAMPLES=3"),
    Run("lock", "STALLS=1"),
    Run("lock", "STALLS=0 CRASHES=1"),
    Run("lock", "STALLS=1 MAKES"),
]
"""`make model` goes through these as well."""

FAULTS = [
    Run("samples", "WEAK F_NO_FENCE_BEFORE"),
    Run("samples", "WEAK F_NO_FENCE_BEHIND"),
    Run("samples", "WEAK F_COPY_LAST"),
    Run("bell", "WEAK F_NO_FENCE_READER"),
    Run("bell", "WEAK F_NO_SECOND_LOOK"),
    Run("bell", "WEAK F_NOT_ARMED"),
    Run("bell", "WEAK F_BELL_FIRST"),
    Run("bell", "WEAK F_BELL_LATE"),
    Run("bell", "WEAK F_UNORDERED"),
    Run("lock", "STALLS=0 TRIES=3 F_COUNT_ONLY"),
    Run("lock", "STALLS=0 TRIES=3 F_HOLDER_FIRST"),
    Run("lock", "STALLS=0 TRIES=3 F_SPARSE"),
    Run("lock", "STALLS=0 MAKES F_NEW_NOT_COUNTED"),
    Run("lock", "FOREVER STALLS=0 CRASHES=1 WITHOUT_Q F_BY_COMPLETED", for_ever=True),
    Run("header", "F_MAGIC_FIRST"),
    Run("header", "DIFFERENT F_NO_SECOND_LOOK"),
]
"""An error must be found in each."""

REMAINS = [
    # A wake-up lost for one slice of 10 ms, by a PLC on ARM, and a header seen half made, where stores pass stores.
    Run("bell", "WEAK F_NO_FENCE_WRITER"),
    Run("header", "WEAK"),
    # Three that make a region at once, one of another layout.
    Run("header", "DIFFERENT THREE"),
]
"""What docs/protocol.md says is not closed: spin finds it, and if it did not the page would be wrong."""
