"""Connects two machines by a cable, each with its own PLC, bridge and /dev/shm, and then simulates faults.

The machines are network and mount namespaces of this machine. Only root may create namespaces.

    python demo.py [--backend dds] [--rate 100] [--python PYTHON_WITH_THE_PACKAGES_OF_THE_BACKEND]
"""

from __future__ import annotations

import argparse
import json
import os
import re
import signal
import subprocess
import sys
import tempfile
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager
from pathlib import Path
from typing import Any

HERE = Path(__file__).parent
TIMEOUT = 40.0
"""Timeout in seconds for each expected event."""


class Machine:
    """A simulated machine with its own network address. It shares only files and processors with this machine."""

    def __init__(self, name: str, other: str, number: int, folder: Path, ends: ExitStack, how: Any) -> None:
        self.name, self.other, self.address, self._how = name, other, f"10.98.0.{number}", how
        self._folder, self._ends = folder, ends
        self.lines: list[str] = []
        holder = ["unshare", "-n", "-m", "sh", "-c", "mount -t tmpfs tmpfs /dev/shm && echo up && exec sleep 600"]
        self._holder = self._start(holder)
        assert self._holder.stdout.readline() == "up\n"
        self.pid = str(self._holder.pid)
        shmgen = [sys.executable, "-m", "shmgen", "generate", "-q", "-t", "python"]
        subprocess.run([*shmgen, "-c", HERE / f"{name}.toml", "-o", folder / name], check=True)

    def plug_in(self) -> None:
        self.ip("link", "set", "lo", "up")
        self.ip("addr", "add", f"{self.address}/24", "dev", "eth0")
        self.ip("link", "set", "eth0", "up")

    def ip(self, *words: str) -> None:
        subprocess.run(["nsenter", "-t", self.pid, "-n", "ip", *words], check=True)

    def start_plc(self) -> None:
        self._plc = self.run(sys.executable, HERE / "plc.py", self.name, self.other, self._how.rate)
        assert self._plc.stdout.readline() == "ready\n"

    def start_bridge(self) -> None:
        command = [Path(self._how.python).absolute(), "-m", "shmgen", "bridge", "--backend", self._how.backend]
        self.bridge = self.run(*command, "-c", HERE / f"{self.name}.toml", stderr=subprocess.STDOUT)
        for line in self.bridge.stdout:
            self.lines.append(line)
            if line == "running\n":
                threading.Thread(target=lambda out=self.bridge.stdout: self.lines.extend(out), daemon=True).start()
                return
        raise SystemExit("".join(self.lines))

    def kill_bridge(self) -> None:
        self.bridge.kill()
        self.bridge.wait()

    def count_lost(self) -> int:
        """Return how many messages did not reach the PLC, according to the counters of the machine's bridge."""
        before = len(self.lines)
        self.bridge.send_signal(signal.SIGUSR1)
        wait(lambda: any(f"/{self.other}/stop " in line for line in self.lines[before:]))
        line = next(line for line in self.lines[before:] if f"/{self.other}/state " in line and " passed" in line)
        return sum(int(count) for count in re.findall(r"(\d+) (?:missed|lost|rejected)", line))

    def statistics(self, new: bool = False) -> dict[str, Any]:
        """Return the statistics of the machine's PLC. If `new` is true, the PLC then starts new lists of times."""
        self._plc.stdin.write("new\n" if new else "\n")
        self._plc.stdin.flush()
        return json.loads(self._plc.stdout.readline())

    def run(self, *words: object, stderr: int | None = None) -> Any:
        """Start a process on the simulated machine."""
        path = os.pathsep.join(filter(None, [f"{self._folder / self.name}/python", os.environ.get("PYTHONPATH")]))
        command = ["nsenter", "-t", self.pid, "-n", "-m", *map(str, words)]
        return self._start(command, {"PYTHONPATH": path}, stderr)

    def _start(self, command: list[str], more: dict[str, str] | None = None, stderr: int | None = None) -> Any:
        bare = {name: value for name, value in os.environ.items() if not name.startswith(("ROS_", "CYCLONEDDS"))}
        environment = {**bare, "PYTHONUNBUFFERED": "1", **(more or {})}
        process = subprocess.Popen(command, env=environment, stdin=-1, stdout=-1, stderr=stderr, text=True)
        self._ends.callback(end, process)
        return process


def main() -> int:
    """Run the demo. Return 0 if all flows recovered and all losses were counted, or 77 without root or namespaces."""
    if os.geteuid() or subprocess.run(["unshare", "-n", "-m", "true"], check=False).returncode:
        print("this demo needs root and network namespaces")
        return 77
    parser = argparse.ArgumentParser()
    parser.add_argument("--backend", default="dds")
    parser.add_argument("--rate", type=int, default=100)
    parser.add_argument("--python", default=sys.executable)
    how = parser.parse_args()
    with tempfile.TemporaryDirectory() as folder, two_machines(Path(folder), how) as (a, b, wire):
        both = (a, b)
        print(f"two machines, {how.backend}: /a/state and /b/state at {how.rate} Hz, and calls of /a/stop and /b/stop")
        wait(lambda: all(machine.statistics()["calls"] for machine in both))
        for machine in both:
            machine.statistics(new=True)
        time.sleep(2)
        print_statistics("a quiet cable", both)

        wire("0.05")
        time.sleep(4)
        print_statistics("every twentieth frame lost", both)

        wire("0.2")
        time.sleep(3)
        wire("0.0")
        time.sleep(1)
        print_statistics("every fifth frame lost", both)

        begun = time.monotonic()
        a.ip("link", "set", "eth0", "down")
        stale = [wait(lambda m=machine: m.statistics()["stale_since"]) - begun for machine in both]
        time.sleep(max(0.0, begun + 4 - time.monotonic()))
        a.ip("link", "set", "eth0", "up")
        begun = time.monotonic()
        wait(lambda: not any(machine.statistics()["stale_since"] for machine in both))
        again = time.monotonic() - begun
        print(f"  link down for 4 s: xStale after {max(stale):.1f} s, FALSE again {again:.1f} s after the link was up")
        time.sleep(1)
        print_statistics("after the cut", both)

        begun = time.monotonic()
        b.kill_bridge()
        stale = [wait(lambda m=machine: m.statistics()["stale_since"]) - begun for machine in both]
        b.start_bridge()
        begun = time.monotonic()
        for machine in both:
            machine.statistics(new=True)
        wait(lambda: all(machine.statistics()["calls"] for machine in both))
        wait(lambda: not any(machine.statistics()["stale_since"] for machine in both))
        again = time.monotonic() - begun
        print(
            f"  bridge of b killed: xStale after {max(stale):.1f} s; all topics and services recovered"
            f" {again:.1f} s after its restart"
        )
    return 0


def print_statistics(when: str, machines: tuple[Machine, Machine]) -> None:
    """Print the statistics of both PLCs. Raises SystemExit if a message was lost without being counted."""
    print(f"  {when}")
    for machine in machines:
        plc, lost = machine.statistics(new=True), machine.count_lost()
        late, calls = (sorted(1e3 * seconds for seconds in plc[key]) for key in ("late", "calls"))
        print(
            f"    {machine.other} to {machine.name}: {len(late)} messages,"
            f" p50 {at(late, 0.5):.1f} ms, p99 {at(late, 0.99):.1f} ms;"
            f" {len(calls)} calls, p50 {at(calls, 0.5):.1f} ms; {plc['gaps']} lost, counted by the PLC"
            f" {plc['missed']} and by the bridge {lost}; calls failed {plc['failed']}",
            flush=True,
        )
        if plc["gaps"] != plc["missed"] + lost:
            raise SystemExit("a lost message was not counted")


def at(values: list[float], share: float) -> float:
    return values[int(share * (len(values) - 1))] if values else float("nan")


@contextmanager
def two_machines(folder: Path, how: Any) -> Iterator[tuple[Machine, Machine, Callable[[str], None]]]:
    """Yield two running machines, and a function that sets how many of all frames their cable drops, from 0 to 1."""
    with ExitStack() as ends:
        a, b = Machine("a", "b", 1, folder, ends, how), Machine("b", "a", 2, folder, ends, how)
        wire = subprocess.Popen([sys.executable, HERE / "wire.py", a.pid, b.pid], stdin=-1, stdout=-1, text=True)
        ends.callback(end, wire)
        assert wire.stdout.readline() == "ready\n"
        for machine in (a, b):
            machine.plug_in()
            machine.start_plc()
            machine.start_bridge()

        def lose(share: str) -> None:
            wire.stdin.write(f"{share}\n")
            wire.stdin.flush()

        yield a, b, lose


def end(process: subprocess.Popen[str]) -> None:
    process.kill()
    process.communicate()


def wait(condition: Callable[[], Any]) -> Any:
    """Wait until `condition` returns a true value, and return the value. Raises SystemExit after 40 s."""
    deadline = time.monotonic() + TIMEOUT
    while not (value := condition()):
        if time.monotonic() > deadline:
            raise SystemExit("something did not come")
        time.sleep(0.05)
    return value


if __name__ == "__main__":
    sys.exit(main())
