"""What the screens of `shmgen view` take of a core with 200 regions that move, and an image of 1 MiB at 30 Hz.

    python -m tests.rigs.load_view

The writers are a process of their own. The screens draw for a terminal of 140 by 40 that nobody sees.
"""

from __future__ import annotations

import argparse
import asyncio
import os
import resource
import subprocess
import sys
import tempfile
import time
from pathlib import Path

from shmgen.config import Config
from shmgen.live.classes import ClassRegistry, publisher
from shmgen.live.session import Session

REGIONS = 200
IMAGE = "sensor_msgs/msg/Image"
NAME = "/shmgen_load/view"


def registry(folder: Path) -> ClassRegistry:
    from shmgen.config import load
    from shmgen.core.diagnostics import Report

    file = folder / "shmgen.toml"
    file.write_text('[bounds]\n"sensor_msgs/Image" = 1048576\n')
    return ClassRegistry(Session(load(file, "shmgen.toml", Report())), None)


def write(folder: Path, seconds: float) -> None:
    """Each region 10 times a second, the image 30 times."""
    pose = ClassRegistry(Session(Config(folder)), None).message("geometry_msgs/msg/PoseStamped")
    image = registry(folder).message(IMAGE)
    writers = [publisher(pose, f"{NAME}/n{number}", 1) for number in range(REGIONS)]
    camera = publisher(image, f"{NAME}/image", 1)
    message, picture = pose(), image(width=1024, height=1024, step=1024, data=bytes(range(256)) * 4096)
    print("ready", flush=True)
    ends, turn = time.monotonic() + seconds, 0
    while time.monotonic() < ends:
        for writer in writers[turn % 3 :: 3]:
            writer.publish(message)
        camera.publish(picture)
        turn += 1
        time.sleep(1 / 30)


def main() -> None:
    parser = argparse.ArgumentParser(description="What shmgen view takes of a core.")
    parser.add_argument("--seconds", type=float, default=15)
    parser.add_argument("--write", type=Path)
    asked = parser.parse_args()
    if asked.write:
        write(asked.write, 1000)
        return
    with tempfile.TemporaryDirectory() as folder:
        command = [sys.executable, "-m", "tests.rigs.load_view", "--write", folder]
        with subprocess.Popen(command, stdout=subprocess.PIPE, text=True) as writer:
            try:
                assert writer.stdout
                writer.stdout.readline()
                for topic in (None, f"{NAME}/image"):
                    asyncio.run(show(Path(folder), topic, asked.seconds))
            finally:
                writer.kill()
                for file in Path("/dev/shm").glob("*shmgen_load.view*"):
                    file.unlink()


async def show(folder: Path, topic: str | None, seconds: float) -> None:
    from shmgen.view.app import Viewer

    app = Viewer(registry(folder), allow_write=False, topic=topic)
    async with app.run_test(size=(140, 40)) as pilot:
        await pilot.pause(2)
        if topic:
            app.screen._source.toggle("width")  # type: ignore[attr-defined]
        busy, begun = time.process_time(), time.monotonic()
        await asyncio.sleep(seconds)
        cpu = (time.process_time() - busy) / (time.monotonic() - begun)
    resident = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    what = f"{topic}, 1 MiB at 30 Hz, one curve" if topic else f"all {REGIONS + 1} regions"
    print(f"{what}: {cpu:.0%} of a core, {resident >> 10} MiB resident, process {os.getpid()}")


if __name__ == "__main__":
    main()
