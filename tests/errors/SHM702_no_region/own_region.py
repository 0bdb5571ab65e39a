"""Runs `shmgen info` for a file in /dev/shm that is not a region. No other test uses its name."""

import contextlib
import io
import os
import sys
from pathlib import Path

from shmgen.cli import main

name = f"shm_error_{os.getpid()}"
file = Path("/dev/shm") / name
file.write_bytes(b"a file of another program")
errors = io.TextIOWrapper(io.BytesIO(), encoding="utf-8", write_through=True)
sys.argv = ["shmgen", "info", f"/{name}"]
try:
    with contextlib.redirect_stderr(errors):
        main.main()
finally:
    file.unlink()
    sys.stderr.write(errors.buffer.getvalue().decode().replace(name, "gripper"))
