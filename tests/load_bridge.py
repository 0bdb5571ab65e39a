"""Turns 30 seconds of 10 topics at 100 Hz and one at 1 kHz into what got lost, how late it came, and what it cost.

    python -m tests.load_bridge --seconds 30 --backend ros1

Twice: once through a plain echo in rospy, or in cyclonedds with `--backend dds`; then through the bridge, the regions,
an echo in Python there, and back.
Exit code 1 if a message neither came nor was counted.
"""

from __future__ import annotations

import argparse
import json
import os
import subprocess
import sys
import tempfile
import time
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from .conftest import REPOSITORY
from .support.dds import Domain
from .support.ros1 import Graph

Ros = Graph | Domain
DEPTH = 255
"""Of each region: a quarter of a second of the fast topic, so that a busy machine has no excuse."""
RATES = {f"t{number}": 100 for number in range(10)} | {"fast": 1000}
SETTLE = 1.0
"""Seconds in which the last messages arrive."""


@dataclass(frozen=True)
class Result:
    """Seconds each message took, by topic; `cpu` of one core.

    `missed` were overwritten in a region before they were read, and counted; `lost` came neither back nor into a count.
    """

    name: str
    sent: int
    latencies: dict[str, list[float]]
    missed: int
    cpu: dict[str, float]

    @property
    def lost(self) -> int:
        return self.sent - self.missed - sum(map(len, self.latencies.values()))

    def __str__(self) -> str:
        both = [
            self.latencies["fast"],
            [one for name in self.latencies for one in self.latencies[name] if name != "fast"],
        ]
        times = "  ".join(f"{1e3 * part(times, 0.5):8.2f}{1e3 * part(times, 0.99):8.2f}" for times in both)
        spent = ", ".join(f"{name} {100 * share:.0f} %" for name, share in self.cpu.items())
        return f"{self.name:<22}{self.sent:>8,}{self.missed:>8}{self.lost:>6}  {times}  {spent}"


def main() -> None:
    """Prints a table."""
    parser = argparse.ArgumentParser(description="10 topics at 100 Hz and one at 1 kHz.")
    parser.add_argument("--seconds", type=float, default=30)
    parser.add_argument("--backend", choices=("ros1", "dds"), default="ros1")
    arguments = parser.parse_args()
    seconds = arguments.seconds
    print(f"{'':<22}{'':>8}{'':>8}{'':>6}  {'1 kHz, ms':>16}  {'100 Hz, ms':>16}  CPU of one core")
    print(f"{'there and back':<22}{'sent':>8}{'missed':>8}{'lost':>6}  {'p50':>8}{'p99':>8}  {'p50':>8}{'p99':>8}")
    lost = 0
    with tempfile.TemporaryDirectory() as folder:
        graph = Graph(Path(folder)) if arguments.backend == "ros1" else Domain(Path(folder), 1 + os.getpid() % 100)
        space = f"/load{os.getpid()}"
        try:
            for result in (plain(graph, f"{space}/plain", seconds), bridged(graph, f"{space}/shm", seconds)):
                print(result, flush=True)
                lost += result.lost
        finally:
            graph.close()
            for file in Path("/dev/shm").glob(f"*{space[1:]}.*"):
                file.unlink()
    sys.exit(1 if lost else 0)


def plain(graph: Ros, space: str, seconds: float) -> Result:
    """An echo with nothing of ours."""
    echo = peer(graph, "echo", space)
    sent, latencies, cpu = run(graph, space, seconds, {"echo": echo.pid})
    return Result(graph.plain_echo, sent, latencies, 0, cpu)


def bridged(graph: Ros, space: str, seconds: float) -> Result:
    """The bridge, and an echo between the regions, here, that sleeps until it is woken."""
    entries = [
        f'[[topics]]\ntopic = "{space}/{name}{end}"\ntype = "geometry_msgs/PoseStamped"\n'
        f'direction = "{direction}"\ndepth = {DEPTH}\n'
        for name in RATES
        for end, direction in (("", "to_plc"), ("_back", "from_plc"))
    ]
    bridge = graph.bridge(f'source = "{graph.source}"\n' + "".join(entries))
    echo = graph.start(
        [sys.executable, "-m", "tests.load_bridge_echo", graph.folder / "shmgen.toml", space],
        {"PYTHONPATH": f"{REPOSITORY / 'src'}:{REPOSITORY}"},
        stdin=subprocess.PIPE,
    )
    assert echo.stdout.readline() == "ready\n"
    sent, latencies, cpu = run(graph, space, seconds, {"bridge": bridge.process.pid, "echo": echo.pid})
    missed = int(echo.communicate("\n")[0])
    bridge.stop(15)
    missed += sum(int(line.split(" missed")[0].split()[-1]) for line in bridge.lines if " missed" in line)
    return Result("bridge, regions, back", sent, latencies, missed, cpu)


def run(graph: Ros, space: str, seconds: float, watched: dict[str, int]) -> tuple[int, Any, dict[str, float]]:
    """How many were sent; what came back; what the watched processes took."""
    sink = peer(graph, "sink", space)
    source = peer(graph, "source", space, str(seconds))
    time.sleep(SETTLE)  # connections from the echo to the sink
    begun, before = time.monotonic(), {name: busy(pid) for name, pid in watched.items()}
    source.stdin.write("\n")
    source.stdin.flush()
    sent = json.loads(source.stdout.readline())
    took = time.monotonic() - begun
    cpu = {name: (busy(pid) - before[name]) / took for name, pid in watched.items()}
    time.sleep(SETTLE)
    seen = json.loads(sink.communicate("\n")[0])
    for name, rows in seen.items():
        numbers = [number for number, _ in rows]
        assert numbers == sorted(set(numbers)), f"{name}: out of order, or twice"
    return sum(sent.values()), {name: [late for _, late in rows] for name, rows in seen.items()}, cpu


def peer(graph: Ros, *arguments: str) -> Any:
    made = graph.start([graph.python, graph.load_peer, *arguments], stdin=subprocess.PIPE)
    assert made.stdout.readline() in ("ready\n", "connected\n")
    return made


def busy(pid: int) -> float:
    """Seconds of CPU."""
    fields = Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()
    return (int(fields[11]) + int(fields[12])) / os.sysconf("SC_CLK_TCK")


def part(times: list[float], share: float) -> float:
    return sorted(times)[int(share * (len(times) - 1))] if times else float("nan")


if __name__ == "__main__":
    main()
