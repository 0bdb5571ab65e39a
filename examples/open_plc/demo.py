"""Runs the conveyor with matiec, the compiler of Beremiz and OpenPLC v3. A service call starts it; then a robot comes.

Set MATIEC to the folder of a built matiec, with iec2c and lib/. Without MATIEC the demo only generates the files.
"""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

HERE = Path(__file__).parent
sys.path.insert(0, str(HERE.parent))

from stage import cell  # noqa: E402 the module is in examples/


def main() -> int:
    """Run the demo and return the exit status of the robot, or 0 if MATIEC is not set."""
    with cell(HERE) as here:
        here.generate()
        output = here.folder / "matiec"
        for path in sorted((*output.iterdir(), *(here.folder / "openplc").iterdir())):
            name, size = path.relative_to(here.folder), path.stat().st_size
            print(f"   generated for OpenPLC and Beremiz: {name}, {size} bytes")
        matiec = os.environ.get("MATIEC", "")
        if not matiec:
            hint = "To run the conveyor, set MATIEC to the folder of a built matiec: see docs/openplc.md."
            print(f"\nMATIEC is not set. {hint}")
            return 0
        compile_by(Path(matiec), output)
        here.start_program("PLC", output / "plc", ready="running")
        here.shmgen("call", "/open/drive", "belt_msgs/Drive", "{may_run: true}")
        status = here.run("../softplc_echo/robot.py", "/open/pose", "/open/conveyor")
        here.shmgen("call", "/open/drive", "belt_msgs/Drive", "{may_run: false}")
        return status


def compile_by(matiec: Path, folder: Path) -> None:
    """Compile the Structured Text to C with iec2c, and the C to a program with the header that the blocks call."""
    print("\n$ iec2c upload.st, and gcc", flush=True)
    call = [matiec / "iec2c", "-f", "-l", "-p", "-I", matiec / "lib", "-T", folder, folder / "upload.st"]
    subprocess.run(call, check=True, stdout=subprocess.DEVNULL)
    options = ["-w", "-O1", "-include", folder / "shm_msgs.h", f"-I{matiec}/lib/C", f"-I{folder}"]
    sources = [folder / "Config0.c", folder / "Res0.c", HERE / "cycle.c"]
    subprocess.run(["gcc", *options, *sources, "-o", folder / "plc", "-lrt", "-lpthread"], check=True)


if __name__ == "__main__":
    sys.exit(main())
