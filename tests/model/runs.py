"""Lists the models for spin: small ones for each test run, large ones for `make model`, and planted faults."""

from __future__ import annotations

from .spin import Run

HOLDS = [
    Run("samples"),
    Run("samples", "WEAK"),
    Run("samples", "WEAK COPY_FIRST"),
    Run("bell"),
    Run("bell", "WEAK"),
]
"""Nothing may be found."""

LARGE = [
    Run("samples", "WEAK SAMPLES=6 READS=3"),
    Run("bell", "WEAK SAMPLES=3"),
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
]
"""An error must be found in each."""

REMAINS = [
    # A wake-up lost for one slice of 10 ms, by a PLC on ARM.
    Run("bell", "WEAK F_NO_FENCE_WRITER"),
]
"""What docs/protocol.md says is not closed: spin finds it, and if it did not the page would be wrong."""
