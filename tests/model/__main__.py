"""Runs all models in spin, small and large, and prints the results: `make model`."""

from __future__ import annotations

import sys

from .runs import FAULTS, HOLDS, LARGE, REMAINS
from .spin import missing, verify

TIMEOUT = 3600.0


def main() -> int:
    if tools := missing():
        print(f"not installed: {', '.join(tools)}")
        return 1
    failures = 0
    for title, runs, sound in (
        ("holds", HOLDS + LARGE, True),
        ("planted faults", FAULTS, False),
        ("known to remain", REMAINS, False),
    ):
        print(f"{title}:")
        for run in runs:
            verdict = verify(run, TIMEOUT, large=run in LARGE)
            result = verdict.error or "nothing found"
            print(f"  {run.id}: {result}, {verdict.states:,} states, {verdict.seconds:.1f} s", flush=True)
            failures += sound == bool(verdict.error)
    print("as expected" if not failures else f"{failures} not as expected")
    return bool(failures)


if __name__ == "__main__":
    sys.exit(main())
