"""Enlarges an array after the code was generated."""

import subprocess
import sys
from pathlib import Path


def generate() -> None:
    subprocess.run([sys.executable, "-m", "shmgen", "generate", "--quiet"], check=True)


generate()
message = Path("msgs/demo_msgs/msg/JointState.msg")
message.write_text(message.read_text().replace("float64[<=8] position", "float64[<=16] position"))
