"""Several readers that wait on one topic: what each misses, and how late it has a sample. Every pairing of ends.

    python -m tests.rigs.readers [--seconds N]

A PLC gives its samples no time, so of one only what is missed counts.
"""

from __future__ import annotations

import argparse
import json
import os
import subprocess
import sys
import tempfile
import time
import uuid
from pathlib import Path
from statistics import quantiles

from tests.support.plc_demo import PACKAGE, Demo, make

DEPTH = 16
WRITERS, READERS = ("c", "python", "plc"), ("c", "python")
END = """
import json, sys, time
sys.path.insert(0, sys.argv[1])
from {package}.demo_msgs.msg import Demo, DemoPublisher, DemoSubscriber
side, topic, hertz, seconds = sys.argv[2], sys.argv[3], int(sys.argv[4]), float(sys.argv[5])
if side == "writer":
    with DemoPublisher(topic, depth={depth}) as publisher:
        print("ready", flush=True)
        message, due = Demo(a=1), time.monotonic()
        while True:
            publisher.publish(message)
            due += 1 / hertz
            time.sleep(max(0.0, due - time.monotonic()))
with DemoSubscriber(topic, depth={depth}) as subscriber:
    print("ready", flush=True)
    subscriber.wait(60)
    subscriber.read_all()
    missed, ages, end = subscriber.missed, [], time.monotonic() + seconds
    while time.monotonic() < end:
        if subscriber.ready(1.0):
            ages += [age for age in [subscriber.age for _ in subscriber.read_all()] if age is not None]
    print(json.dumps([subscriber.missed - missed, ages]), flush=True)
"""


def run(demo: Demo, folder: Path, writer: str, reader: str, readers: int, hertz: int, seconds: float) -> str:
    """A row of the table."""
    topic = f"/shmgen_test/readers/r{uuid.uuid4().hex}"
    program = END.replace("{package}", PACKAGE).replace("{depth}", str(DEPTH))
    numbers = [str(hertz), str(seconds)]

    def started(side: str, kind: str) -> subprocess.Popen[str]:
        environment = {**os.environ, **({"SHMGEN_PURE": "1"} if kind == "python" else {})}
        command = [sys.executable, "-c", program, str(folder / "python"), side, topic, *numbers]
        if kind == "plc":
            inputs = ["xEnable=true", "xSend=true", f'sTopic="{topic}"', f"udiDepth={DEPTH}"]
            block = "FB_demo_msgs_Demo_Publisher"
            command = [sys.executable, "-m", "tests.softplc.task", str(demo.library), block]
            command += ["--period", str(1 / hertz), "--set", *inputs]
        process = subprocess.Popen(command, env=environment, stdout=subprocess.PIPE, text=True)
        assert process.stdout
        process.stdout.readline()
        return process

    listening = [started("reader", reader) for _ in range(readers)]
    writing = started("writer", writer)
    try:
        said = [json.loads(one.communicate(timeout=60 + seconds)[0]) for one in listening]
    finally:
        for process in (*listening, writing):
            process.kill()
            process.wait()
        for file in Path("/dev/shm").glob(f"*{topic.rpartition('/')[2]}*"):
            file.unlink()
    missed, ages = sum(one for one, _ in said), sorted(age * 1e3 for _, ages in said for age in ages)
    late = "" if writer == "plc" else f"{quantiles(ages, n=100)[49]:.2f} | {quantiles(ages, n=100)[98]:.2f}"
    return f"| {writer} | {reader} | {hertz} | {readers} | {missed} | {late or ' | '} |"


def main() -> None:
    """Prints a table for docs/performance.md."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--seconds", type=float, default=3)
    seconds = parser.parse_args().seconds
    print(
        "| writer | readers in | Hz | readers | missed | p50 ms | p99 ms |\n|---|---|---|---|---|---|---|", flush=True
    )
    with tempfile.TemporaryDirectory(prefix="shmgen-readers-") as name:
        demo = make(Path(name))
        for writer in WRITERS:
            for reader in READERS:
                for hertz in (200, 1000):
                    for readers in (1, 2, 4, 8):
                        print(run(demo, Path(name), writer, reader, readers, hertz, seconds), flush=True)
                        time.sleep(0.2)


if __name__ == "__main__":
    main()
