"""Plants faults in the C headers, one at a time, and checks that a test detects each: `make mutants`.

    python -m tests.rigs.header_faults [NAME ...]

The faults are those of tests/explorer/faults.toml that name a test. All happens in a copy of the checkout. The exit
code is 1 if a test does not detect its fault, or if the test fails without the fault.
"""

from __future__ import annotations

import os
import sys
import tempfile
from pathlib import Path

from tests.explorer.faults import TESTED, Fault
from tests.support.mutation_worker import Worker

SECONDS = 120
"""The timeout of each test."""


def run_fault(worker: Worker, fault: Fault) -> str:
    """Return the result of a fault's test: killed, hung or lives. Report a test that fails without the fault."""
    path = next((worker.copy / "templates").rglob(fault.file))
    text = path.read_text()
    if worker.try_text(path, text.encode(), [fault.test], SECONDS, pure=False) != "lives":
        return f"{fault.test} fails without it"
    wrong = fault.planted({str(path): text})[str(path)]
    return worker.try_text(path, wrong.encode(), [fault.test], SECONDS, pure=False)


def main() -> None:
    """Test each fault and print its result."""
    faults = [fault for fault in TESTED if not sys.argv[1:] or fault.name in sys.argv[1:]]
    with tempfile.TemporaryDirectory(prefix="shmgen-faults") as folder:
        os.chmod(folder, 0o755)
        worker = Worker(Path(folder))
        try:
            results = [run_fault(worker, fault) for fault in faults]
        finally:
            worker.close()
    for fault, how in zip(faults, results, strict=True):
        print(f"{fault.name}: {how} by {fault.test}" if how == "killed" else f"{fault.name}: {how}")
    sys.exit(any(how != "killed" for how in results))


if __name__ == "__main__":
    main()
