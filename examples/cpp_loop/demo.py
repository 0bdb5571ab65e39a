"""Runs a 1 kHz control loop in C++ with a drive that a PLC simulates, and prints how late each cycle began."""

from __future__ import annotations

import shutil
import subprocess
import sys
from pathlib import Path

HERE = Path(__file__).parent
SECONDS = 3
sys.path.insert(0, str(HERE.parent))

from stage import cell  # noqa: E402 the module is in examples/


def main() -> int:
    """Run the demo. Return 0 if every cycle sent its command."""
    if not shutil.which("g++"):
        sys.exit("g++ is not installed")
    with cell(HERE, "blark") as here:
        here.generate()
        program = here.folder / "loop"
        print("\n$ g++ -std=c++17 -O2 -I generated/cpp loop.cpp -o loop", flush=True)
        flags = ["-std=c++17", "-O2", "-Wall", "-Wextra", "-Werror", f"-I{here.folder}/cpp"]
        subprocess.run(["g++", *flags, HERE / "loop.cpp", "-o", program, "-lrt", "-lpthread"], check=True)
        here.start_plc("PRG_Drive")
        print(f"\n$ ./loop {SECONDS}", flush=True)
        done = subprocess.run([program, str(SECONDS)], stdout=subprocess.PIPE, text=True, check=False)
        for line in done.stdout.splitlines():
            print(f"   {line}", flush=True)
    return done.returncode


if __name__ == "__main__":
    sys.exit(main())
