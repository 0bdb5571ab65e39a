"""Replaces the PLC in load_bridge.py: copies each sample from the bridge's region into the region to the bridge.

    python -m tests.rigs.load_bridge_echo shmgen.toml SPACE

A line on standard input ends the process, which then prints how many samples it missed.
"""

from __future__ import annotations

import sys
import threading
from pathlib import Path

from shmgen.config import load
from shmgen.core.diagnostics import Report
from shmgen.live.classes import publisher, subscriber
from shmgen.live.session import Session

TYPE = "geometry_msgs/PoseStamped"


def main(config: str, space: str) -> None:
    """Run a thread for each topic, which sleeps until a sample arrives."""
    loaded = load(Path(config), config, Report())
    kind = Session(loaded).classes([TYPE])["geometry_msgs/msg/PoseStamped"]
    stopping = threading.Event()
    missed: list[int] = []

    def echo(topic: str, depth: int) -> None:
        with subscriber(kind, topic, depth) as reader, publisher(kind, f"{topic}_back", depth) as writer:
            while not stopping.is_set():
                if reader.ready(0.1):
                    for sample in reader.read_all():
                        writer.publish(sample)
            missed.append(reader.missed)

    threads = [
        threading.Thread(target=echo, args=(topic.topic, topic.depth))
        for topic in loaded.topics
        if topic.direction == "to_plc"
    ]
    for thread in threads:
        thread.start()
    print("ready", flush=True)
    sys.stdin.readline()
    stopping.set()
    for thread in threads:
        thread.join()
    print(sum(missed), flush=True)


if __name__ == "__main__":
    main(*sys.argv[1:])
