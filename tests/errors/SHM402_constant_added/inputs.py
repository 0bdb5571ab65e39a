"""Adds a constant after the code was generated."""

import subprocess
import sys
from pathlib import Path


def generate() -> None:
    subprocess.run([sys.executable, "-m", "shmgen", "generate", "--quiet"], check=True)


generate()
message = Path("msgs/demo_msgs/msg/JointState.msg")
message.write_text("uint8 STOPPED=0\n" + message.read_text())
