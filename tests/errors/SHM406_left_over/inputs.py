"""Creates a temporary file, as a killed run leaves it."""

import subprocess
import sys
from pathlib import Path


def generate() -> None:
    subprocess.run([sys.executable, "-m", "shmgen", "generate", "--quiet"], check=True)


generate()
Path("generated/c/shm_msgs/.shmgen.h.shmgen-k2hd7_ab.tmp").write_text("half")
