"""Analyses every harness, and each once more with a planted fault, which Eva must find: `python -m tests.prove`."""

import sys
from pathlib import Path
from tempfile import TemporaryDirectory

from tests.prove.eva import HARNESSES, generate, prove

if __name__ == "__main__":
    failed = False
    with TemporaryDirectory() as folder:
        headers = generate(Path(folder))
        for harness in HARNESSES:
            proof = prove(harness, headers)
            faulty_proof = prove(harness, headers, planted=True)
            failed |= not proof.holds or faulty_proof.holds
            print(
                f"{harness.name:6} {proof}; {'MISSED' if faulty_proof.holds else 'finds'}: {harness.fault.new.strip()}",
                flush=True,
            )
    sys.exit(failed)
