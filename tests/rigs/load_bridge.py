"""Runs 11 topics through the bridge for 30 seconds, and prints the lost messages, the latencies, CPU time and memory.

    python -m tests.rigs.load_bridge --seconds 30 --backend ros2 --backend ros2_cpp

Ten topics have 100 Hz and one has 1 kHz. The first run uses a plain echo without shmgen: in rospy, in rclpy of Jazzy,
in zenoh, or in cyclonedds. With `--backend dds`, a second echo does not decode the bytes. The next run uses the bridge,
the regions, and an echo in Python between the regions. The last run is the same, while service calls wait for a PLC
that does not exist. `ros2_cpp` replaces the bridge by the generated node in C++ (`-t ros2_cpp`). The exit code is 1 if
the bridge lost a message without counting it.
"""

from __future__ import annotations

import argparse
import json
import os
import re
import subprocess
import sys
import tempfile
import time
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from ..support import REPOSITORY, rclcpp, ros2, zenoh
from ..support.dds import Domain
from ..support.ros1 import Graph

Ros = Graph | Domain | ros2.Graph | zenoh.Graph
BACKENDS = ("ros1", "ros2", "ros2_cpp", "dds", "zenoh")
DEPTH = 255
"""The depth of each region: a quarter of a second of the fast topic, for pauses of a busy machine."""
RATES = {f"t{number}": 100 for number in range(10)} | {"fast": 1000}
SETTLE = 1.0
"""Seconds in which the last messages arrive."""


@dataclass(frozen=True)
class Run:
    """The measurements of one run.

    `latencies` are the seconds that each message took, by topic. `dropped` counts messages that the receiver itself
    dropped. `cpu` is the share of one core, and `memory` is in MiB, both by process.
    """

    sent: int
    latencies: dict[str, list[float]]
    dropped: int
    cpu: dict[str, float]
    memory: dict[str, int]


@dataclass(frozen=True)
class Result:
    """A line of the table. `missed` counts messages that were overwritten before they were read."""

    name: str
    run: Run
    missed: int

    @property
    def lost(self) -> int:
        """The number of messages that were neither received nor counted."""
        return self.run.sent - self.missed - self.run.dropped - sum(map(len, self.run.latencies.values()))

    def __str__(self) -> str:
        late = self.run.latencies
        both = [late["fast"], [seconds for name in late for seconds in late[name] if name != "fast"]]
        times = "  ".join(f"{1e3 * quantile(times, 0.5):8.2f}{1e3 * quantile(times, 0.99):8.2f}" for times in both)
        memory = self.run.memory
        spent = ", ".join(f"{name} {100 * share:.0f} % {memory[name]} MiB" for name, share in self.run.cpu.items())
        return (
            f"{self.name:<22}{self.run.sent:>8,}{self.missed:>8}{self.run.dropped:>9}{self.lost:>6}  {times}  {spent}"
        )


def main() -> None:
    """Run the load with each backend and print a table."""
    parser = argparse.ArgumentParser(description="10 topics at 100 Hz and one at 1 kHz.")
    parser.add_argument("--seconds", type=float, default=30)
    parser.add_argument(
        "--backend", action="append", choices=("ros1", "ros2", "ros2_cpp", "dds", "zenoh"), required=True
    )
    arguments = parser.parse_args()
    print(f"{'':<22}{'':>8}{'':>8}{'':>9}{'':>6}  {'1 kHz, ms':>16}  {'100 Hz, ms':>16}  CPU of one core, memory")
    heads = "".join(f"{head:>{width}}" for head, width in (("sent", 8), ("missed", 8), ("by sink", 9), ("lost", 6)))
    print(f"{'there and back':<22}{heads}  {'p50':>8}{'p99':>8}  {'p50':>8}{'p99':>8}")
    sys.exit(1 if sum([measure(backend, arguments.seconds) for backend in arguments.backend]) else 0)


def measure(backend: str, seconds: float) -> int:
    """Print a line for each echo node and for each bridge. Return the number of messages that the bridges lost."""
    space, lost = f"/load{os.getpid()}", 0
    print(backend)
    with tempfile.TemporaryDirectory() as folder:
        graph = make_graph(backend, Path(folder))
        try:
            for role, name in graph.plain:
                print(run_plain(graph, role, name, f"{space}/{role}", seconds), flush=True)
            for calls in (False, True):
                result = bridged(graph, f"{space}/{'calls' if calls else 'shm'}", seconds, calls)
                print(result, flush=True)
                lost += result.lost
        finally:
            graph.close()
            for file in Path("/dev/shm").glob(f"*{space[1:]}.*"):
                file.unlink()
    return lost


def make_graph(backend: str, folder: Path) -> Ros:
    """Return a ROS graph, or a DDS domain, that no other process uses."""
    number = 1 + os.getpid() % 100
    if backend == "ros1":
        return Graph(folder)
    if backend == "zenoh":
        graph = zenoh.Graph(folder, number)
        graph.router()
        return graph
    kinds = {"ros2": ros2.Graph, "ros2_cpp": rclcpp.CppGraph, "dds": Domain}
    return kinds[backend](folder, number)


def run_plain(graph: Ros, role: str, name: str, space: str, seconds: float) -> Result:
    """Measure an echo that does not use shmgen."""
    echo = peer(graph, role, space)
    return Result(name, run(graph, space, seconds, {"echo": echo.pid}), 0)


def bridged(graph: Ros, space: str, seconds: float, calls: bool = False) -> Result:
    """Measure the bridge, with an echo between the regions that sleeps until a sample arrives."""
    service = f'[[services]]\nservice = "{space}/call"\ntype = "std_srvs/SetBool"\nserver = "plc"\n' if calls else ""
    entries = [
        f'[[topics]]\ntopic = "{space}/{name}{end}"\ntype = "geometry_msgs/PoseStamped"\n'
        f'direction = "{direction}"\ndepth = {DEPTH}\n'
        for name in RATES
        for end, direction in (("", "to_plc"), ("_back", "from_plc"))
    ]
    bridge = graph.bridge(f'source = "{graph.source}"\n' + "".join(entries) + service)
    echo = graph.start(
        [sys.executable, "-m", "tests.rigs.load_bridge_echo", graph.folder / "shmgen.toml", space],
        {"PYTHONPATH": f"{REPOSITORY / 'src'}:{REPOSITORY}"},
        stdin=subprocess.PIPE,
    )
    assert echo.stdout.readline() == "ready\n"
    if calls:
        peer(graph, "caller", space)
    result = run(graph, space, seconds, {"bridge": bridge.process.pid, "echo": echo.pid})
    missed = int(echo.communicate("\n")[0])
    bridge.stop(15)
    assert not calls or any(re.search(r"\d failed", line) for line in bridge.lines), "no call has waited"
    missed += sum(int(count) for line in bridge.lines for count in re.findall(r"(\d+) (?:missed|lost)", line))
    return Result("while calls wait" if calls else "bridge, regions, back", result, missed)


def run(graph: Ros, space: str, seconds: float, watched: dict[str, int]) -> Run:
    """Send messages for `seconds`. Return the latencies, and the CPU time and memory of the processes in `watched`."""
    sink = peer(graph, "sink", space)
    source = peer(graph, "source", space, str(seconds))
    time.sleep(SETTLE)  # until the echo is connected to the sink
    begun, before = time.monotonic(), {name: busy(pid) for name, pid in watched.items()}
    source.stdin.write("\n")
    source.stdin.flush()
    sent = json.loads(source.stdout.readline())
    took = time.monotonic() - begun
    cpu = {name: (busy(pid) - before[name]) / took for name, pid in watched.items()}
    memory = {name: resident(pid) for name, pid in watched.items()}
    time.sleep(SETTLE)
    report = json.loads(sink.communicate("\n")[0])
    seen = report["seen"]
    for name, rows in seen.items():
        numbers = [number for number, _ in rows]
        assert numbers == sorted(set(numbers)), f"{name}: out of order, or twice"
    late = {name: [took for _, took in rows] for name, rows in seen.items()}
    return Run(sum(sent.values()), late, report["dropped"], cpu, memory)


def peer(graph: Ros, *arguments: str) -> Any:
    process = graph.start([graph.python, graph.load_peer, *arguments], stdin=subprocess.PIPE)
    assert process.stdout.readline() in ("ready\n", "connected\n")
    return process


def busy(pid: int) -> float:
    """Return the CPU time of a process in seconds."""
    fields = Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()
    return (int(fields[11]) + int(fields[12])) / os.sysconf("SC_CLK_TCK")


def resident(pid: int) -> int:
    """Return the memory of a process in MiB."""
    return int(Path(f"/proc/{pid}/statm").read_text().split()[1]) * os.sysconf("SC_PAGE_SIZE") // 2**20


def quantile(times: list[float], share: float) -> float:
    return sorted(times)[int(share * (len(times) - 1))] if times else float("nan")


if __name__ == "__main__":
    main()
