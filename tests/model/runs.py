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
"""Models in which spin must find no error."""

LARGE = [
    Run("samples", "WEAK SAMPLES=6 READS=3"),
    Run("bell", "WEAK SAMPLES=3"),
]
"""Larger models, only for `make model`."""

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
"""Models with a planted fault, which spin must find."""

REMAINS = [
    # On ARM, a PLC's wake-up may be lost; the reader then sleeps for up to 10 ms.
    Run("bell", "WEAK F_NO_FENCE_WRITER"),
]
"""Known gaps of docs/protocol.md. spin must find them; otherwise, the page is wrong."""
