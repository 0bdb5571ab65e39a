"""A minute of 64 topics at 1 kHz, recorded into a bag: misses, CPU and memory of the recorder.

    python -m tests.rigs.load_record --seconds 60

First the writer alone, then with `shmgen record`: how long its cycles take says whether it feels the recorder. Exit
code 1 if a sample is neither in the bag nor counted as missed, or the bag does not say the same to PyPI's mcap.
"""

from __future__ import annotations

import argparse
import os
import signal
import subprocess
import sys
import tempfile
import time
from itertools import pairwise
from pathlib import Path

from shmgen.config import Config
from shmgen.live.classes import ClassRegistry, publisher
from shmgen.live.session import Session
from shmgen.runtime import region_name

TOPICS = 64
DEPTH = 16
PERIOD = 0.001


def main() -> None:
    parser = argparse.ArgumentParser(description="64 topics at 1 kHz, recorded.")
    parser.add_argument("--seconds", type=float, default=60)
    parser.add_argument("--type", default="geometry_msgs/PoseStamped")
    parser.add_argument("--depth", type=int, default=DEPTH)
    asked = parser.parse_args()
    names = [f"/shmgen_load/r{os.getpid()}/n{number}" for number in range(TOPICS)]
    with tempfile.TemporaryDirectory() as folder:
        try:
            sys.exit(run(names, asked.type, asked.depth, asked.seconds, Path(folder)))
        finally:
            for name in names:
                for file in Path("/dev/shm").glob(f"*{region_name(name)}*"):
                    file.unlink()


def run(names: list[str], kind: str, depth: int, seconds: float, folder: Path) -> int:
    made = ClassRegistry(Session(Config(folder)), None).message(kind)
    writers = [publisher(made, name, depth) for name in names]
    alone = write(writers, made(), min(10.0, seconds))
    before = sum(writer.sequence for writer in writers)
    command = [sys.executable, "-m", "shmgen", "record", *names, "-o", str(folder / "bag")]
    with subprocess.Popen(command, cwd=folder, stdout=subprocess.PIPE, text=True) as recorder:
        while not (folder / "bag").exists():
            time.sleep(0.05)
        time.sleep(0.5)
        busy, begun = _busy(recorder.pid), time.monotonic()
        beside = write(writers, made(), seconds)
        cpu = (_busy(recorder.pid) - busy) / (time.monotonic() - begun)
        resident = _resident(recorder.pid)
        time.sleep(0.1)
        recorder.send_signal(signal.SIGINT)
        said, _ = recorder.communicate()
    written = sum(writer.sequence for writer in writers) - before
    print(f"writer alone: {alone}\nwriter with the recorder: {beside}")
    print(f"recorder: {cpu:.0%} of a core, {resident} KiB resident; {said.strip()}")
    return check(folder / "bag", written)


def write(writers: list, message: object, seconds: float) -> str:
    """Cycles of all topics; how long they took."""
    took = []
    start = time.monotonic()
    for number in range(round(seconds / PERIOD)):
        left = start + number * PERIOD - time.monotonic()
        if left > 0:
            time.sleep(left)
        begun = time.perf_counter()
        for writer in writers:
            writer.publish(message)
        took.append(time.perf_counter() - begun)
    took.sort()
    micro = [1e6 * took[int(len(took) * share)] for share in (0.5, 0.99)]
    lasted = time.monotonic() - start
    rate = len(took) * len(writers) / lasted
    return f"{rate:,.0f} samples/s, a cycle takes {micro[0]:.0f} us, 99 of 100 at most {micro[1]:.0f} us"


def check(bag: Path, written: int) -> int:
    """Every number once, in order; what is not there was counted."""
    import json

    from mcap.reader import make_reader

    numbers: dict[str, list[int]] = {}
    missed = 0
    for file in sorted(bag.glob("*.mcap")):
        with file.open("rb") as stream:
            reader = make_reader(stream)
            for _, channel, message in reader.iter_messages(log_time_order=False):
                numbers.setdefault(channel.topic, []).append(message.sequence)
        with file.open("rb") as stream:
            for record in make_reader(stream).iter_metadata():
                missed += sum(json.loads(record.metadata.get("missed", "{}")).values())
    recorded = sum(map(len, numbers.values()))
    ordered = all(a < b for seen in numbers.values() for a, b in pairwise(seen))
    # Of each topic the newest sample that was there at first is recorded as well.
    whole = recorded + missed == written + len(numbers)
    of = f"{recorded:,} of {written + len(numbers):,} samples"
    print(f"bag: {of}, {missed:,} missed, by PyPI's mcap; in order: {ordered}")
    return 0 if ordered and whole else 1


def _busy(pid: int) -> float:
    fields = Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()
    return (int(fields[11]) + int(fields[12])) / os.sysconf("SC_CLK_TCK")


def _resident(pid: int) -> int:
    lines = Path(f"/proc/{pid}/status").read_text().splitlines()
    return next(int(line.split()[1]) for line in lines if line.startswith("VmHWM"))


if __name__ == "__main__":
    main()
