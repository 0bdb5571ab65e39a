"""Calls a service that has no server, and removes its regions. No other test uses its name."""

import contextlib
import io
import os
import sys
from pathlib import Path

from shmgen.cli import main

name = f"shm_error_{os.getpid()}"
errors = io.TextIOWrapper(io.BytesIO(), encoding="utf-8", write_through=True)
sys.argv = ["shmgen", "call", f"/{name}", "std_srvs/Trigger", "--timeout", "0", "--json"]
try:
    with contextlib.redirect_stderr(errors):
        main.main()
finally:
    for file in Path("/dev/shm").glob(f"*{name}*"):
        file.unlink()
    sys.stderr.write(errors.buffer.getvalue().decode().replace(f"/{name}", "/cell/start"))
