"""Edits a generated header."""

import subprocess
import sys
from pathlib import Path


def generate() -> None:
    subprocess.run([sys.executable, "-m", "shmgen", "generate", "--quiet"], check=True)


generate()
header = Path("generated/c/shm_msgs/demo_msgs/msg/joint_state.h")
header.write_text(header.read_text() + "/* mine */\n")
