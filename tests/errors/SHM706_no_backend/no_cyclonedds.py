"""Starts a bridge in a Python that lacks the library of the backend."""

import sys

from shmgen.cli import main

sys.modules["cyclonedds"] = None  # type: ignore[assignment]
sys.argv = ["shmgen", "bridge", "--backend", "dds"]
main.main()
