"""Sets a longer task interval after the code was generated."""

import subprocess
import sys
from pathlib import Path


def generate() -> None:
    subprocess.run([sys.executable, "-m", "shmgen", "generate", "--quiet"], check=True)


generate()
settings = Path("shmgen.toml")
settings.write_text(settings.read_text() + "task_interval = 20\n")
