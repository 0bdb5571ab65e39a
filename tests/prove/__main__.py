"""Analyses every harness, and each once more with a planted fault, which Eva must find: `python -m tests.prove`."""

import sys
from pathlib import Path
from tempfile import TemporaryDirectory

from tests.prove.eva import HARNESSES, generate, said

if __name__ == "__main__":
    wrong = False
    with TemporaryDirectory() as folder:
        headers = generate(Path(folder))
        for harness in HARNESSES:
            proof = said(harness, headers)
            found = said(harness, headers, planted=True)
            wrong |= not proof.holds or found.holds
            print(
                f"{harness.name:6} {proof}; {'MISSED' if found.holds else 'finds'}: {harness.fault.new.strip()}",
                flush=True,
            )
    sys.exit(wrong)
