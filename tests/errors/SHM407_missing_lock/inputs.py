"""Deletes layout.lock."""

import subprocess
import sys
from pathlib import Path


def generate() -> None:
    subprocess.run([sys.executable, "-m", "shmgen", "generate", "--quiet"], check=True)


generate()
Path("generated/layout.lock").unlink()
