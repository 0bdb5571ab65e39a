"""Generates code for two topics, runs the PLC side of it in a 1 ms cycle, and lets a robot walk up to the conveyor.

The PLC here is a stand-in for tests and demos (tests/softplc), not a PLC: it compiles the Structured Text, generated
and written by hand, by way of C++, and calls it as a task would.
"""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
import tempfile
from contextlib import suppress
from pathlib import Path

import posix_ipc

HERE = Path(__file__).parent
REPOSITORY = HERE.parents[1]
POSES, STATES = "/cell/pose", "/cell/conveyor"


def main() -> int:
    """Exit status of the robot."""
    shmgen = shutil.which("shmgen")
    if shmgen is None:
        sys.exit("shmgen is not installed here: `make demo` does that")
    with tempfile.TemporaryDirectory() as folder:
        step("shmgen generate")
        subprocess.run([shmgen, "generate", "--quiet", "-c", HERE / "shmgen.toml", "-o", folder], check=True)
        for path in sorted(Path(folder).rglob("*onveyor*")):
            if path.is_file():
                print(f"   {path.relative_to(folder)}")
        step("shmgen show geometry_msgs/Pose")
        subprocess.run([shmgen, "show", "geometry_msgs/Pose"], check=True)

        print("\nThe PLC: PRG_Conveyor.st and what was generated, compiled and called every millisecond", flush=True)
        plc = start_plc(Path(folder))
        try:
            environment = {**os.environ, "PYTHONPATH": f"{folder}/python"}
            robot = subprocess.run([sys.executable, HERE / "robot.py", POSES, STATES], env=environment, timeout=60)
        finally:
            plc.kill()
            plc.wait()
            for topic in (POSES, STATES):
                forget(topic)
    return robot.returncode


def start_plc(folder: Path) -> subprocess.Popen[str]:
    """A process that runs PRG_Ros and PRG_Conveyor, once its first cycle is over."""
    sys.path.insert(0, str(REPOSITORY))
    from tests.softplc import compile_st

    sources = [*(folder / "st").rglob("*.st"), HERE / "PRG_Conveyor.st"]
    compile_st({path.name: path.read_text() for path in sources}, folder / "plc")
    task = [sys.executable, "-m", "tests.softplc.task", folder / "plc" / "plc.so", "PRG_Ros", "PRG_Conveyor"]
    plc = subprocess.Popen([*task, "--period", "0.001"], cwd=REPOSITORY, stdout=subprocess.PIPE, text=True)
    assert plc.stdout
    print(f"   process {plc.pid}: {plc.stdout.readline().strip()}")
    return plc


def forget(topic: str) -> None:
    """Removes the region, which neither side did: here both are known to have ended."""
    name = "/" + topic.strip("/").replace("/", ".")
    posix_ipc.unlink_shared_memory(name)
    for semaphore in (name, f"{name}-event"):
        with suppress(posix_ipc.ExistentialError):
            posix_ipc.unlink_semaphore(semaphore)


def step(command: str) -> None:
    print(f"\n$ {command}", flush=True)


if __name__ == "__main__":
    sys.exit(main())
