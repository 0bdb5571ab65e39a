"""Changes a unit and exchanges two constants after the code was generated."""

import subprocess
import sys
from pathlib import Path


def generate() -> None:
    subprocess.run([sys.executable, "-m", "shmgen", "generate", "--quiet"], check=True)


generate()
message = Path("msgs/demo_msgs/msg/JointState.msg")
text = message.read_text().replace("[rad/s]", "[deg/s]")
message.write_text(text.replace("ARC=1", "ARC=2").replace("FAULT=2", "FAULT=1"))
