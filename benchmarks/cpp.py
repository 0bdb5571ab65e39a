"""Times publishing in C++, and compares each case with hand-written code for the same work in the same program.

    python benchmarks/cpp.py

Targets: publishing a Pose takes at most 1.2 times a lock and a memcpy by hand, both with or both without a time stamp.
Publishing 1 MiB takes at most 1.1 times the copy alone.
"""

from __future__ import annotations

import statistics
import subprocess
import tempfile
from pathlib import Path

from peers import generated

ROUNDS = 401
NAMES = (
    "sem_wait, memcpy, sem_post",
    "publish(Pose), Options::unstamped",
    "by hand with a time stamp (clock_gettime)",
    "publish(Pose)",
    "try_publish(Pose)",
    "memcpy of 1 MiB into two mapped slots in turn",
    "publish(1 MiB)",
)
FLOOR = (0, 0, 2, 2, 2, 5, 5)
"""The index of the row that each row is compared with."""


def main() -> None:
    """Run the benchmark and print a row for each case."""
    with tempfile.TemporaryDirectory() as folder:
        command = [generated.program(Path(folder)), "publish", str(ROUNDS)]
        printed = subprocess.run(command, capture_output=True, text=True, check=True).stdout
    rows = list(zip(*([float(word) for word in line.split()] for line in printed.splitlines()), strict=True))
    print(f"{'C++, g++ -O2':<48}{'ns':>12}{'ratio':>8}")
    for name, floor, row in zip(NAMES, FLOOR, rows, strict=True):
        ratio = statistics.median(mine / base for mine, base in zip(row, rows[floor], strict=True))
        print(f"  {name:<46}{statistics.median(row):>12,.0f}{ratio:>8.2f}")


if __name__ == "__main__":
    main()
