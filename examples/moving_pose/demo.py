"""Generates geometry_msgs/Pose, then lets two processes exchange a moving pose through one shared region."""

from __future__ import annotations

import subprocess
import sys
import tempfile
from contextlib import suppress
from pathlib import Path

import posix_ipc

HERE = Path(__file__).parent
SHMGEN = (sys.executable, "-m", "shmgen")
TOPIC = "/shmgen_demo/pose"


def main() -> int:
    """Run the demo and return the exit status of the reader: 0 if all poses arrived."""
    with tempfile.TemporaryDirectory() as folder:
        step(f"shmgen generate geometry_msgs/Pose sensor_msgs/Imu  (into {folder})")
        generate = [*SHMGEN, "generate", "geometry_msgs/Pose", "sensor_msgs/Imu", "--quiet", "--output", folder]
        subprocess.run(generate, check=True)
        for file in sorted(path.relative_to(folder) for path in Path(folder).rglob("*pose*") if path.is_file()):
            print(f"   {file}")
        for file in sorted(path.relative_to(folder) for path in Path(folder).rglob("*_Pose*") if path.is_file()):
            print(f"   {file}")

        step("shmgen show geometry_msgs/Pose")
        subprocess.run([*SHMGEN, "show", "geometry_msgs/Pose"], check=True)

        step(f"two processes, one region: {TOPIC}")
        python = [sys.executable]
        environment = {"PYTHONPATH": f"{folder}/python", "PYTHONUNBUFFERED": "1"}
        reader = subprocess.Popen([*python, str(HERE / "reader.py"), TOPIC], env=environment)
        writer = subprocess.Popen([*python, str(HERE / "robot.py"), TOPIC], env=environment)
        status = reader.wait(timeout=120)
        writer.terminate()
        writer.wait(timeout=10)
    forget(TOPIC)
    return status


def forget(topic: str) -> None:
    """Remove the region of the topic. Publisher and subscriber have ended, and ending does not remove the region."""
    name = "/" + topic.strip("/").replace("/", ".")
    posix_ipc.unlink_shared_memory(name)
    for semaphore in (name, f"{name}-event"):
        with suppress(posix_ipc.ExistentialError):
            posix_ipc.unlink_semaphore(semaphore)


def step(text: str) -> None:
    print(f"\n$ {text}" if text.startswith("shmgen") else f"\n-- {text}", flush=True)


if __name__ == "__main__":
    sys.exit(main())
