"""Measures the age of samples and the reader's CPU time in a stream between two processes, and compares libraries.

    python benchmarks/latency.py [--rounds 3] [--seconds 0.5] [--only shmgen,UDP]

A sample carries the time at which it was sent. Its age is measured in microseconds when the receiver has the sample as
a message object. The rate is 1 kHz (1 MiB: 100 Hz). The sender sleeps between two samples, like a cyclic program. The
rounds of all rows alternate. A figure is the median of the rounds' medians. A ratio is to shmgen in the same mode and
the same round.

The row C++ is the code that shmgen generates. The row C is its baseline: two slots and a sequence number. In the rows
"in place" the reader reads a whole sample inside the region, like the reader of iceoryx2 for 1 MiB. The last table has
several readers that sleep.

Targets: C++ takes at most 1.5 times C. An event takes at most 1.3 times an event by hand, and under 2 % of a core. A
Pose is faster than with all other libraries.
"""

from __future__ import annotations

import argparse
import importlib.metadata
import os
import resource
import statistics
import subprocess
import sys
import tempfile
import threading
import time
from contextlib import ExitStack
from pathlib import Path
from subprocess import DEVNULL

from peers import LIBRARIES, generated, networks, remove

from shmgen.core.plural import counted

HERE = Path(__file__).parent
MODES = ("spin", "event", "poll")
SIZES = {56: 1000, 320: 1000, 1 << 20: 100}
POLLED = ("shmgen", "by hand")
WOKEN_ONLY = ("Modbus TCP (pymodbus)", "OPC UA (asyncua)")
LARGEST = {"Modbus TCP (pymodbus)": 240, "cyclonedds": 1 << 16}
"""Maximum bytes per peer. A Modbus write has at most 123 registers. DDS octets pass through a slow Python list."""
MANY = ("shmgen", "iceoryx2")
"""Libraries with which one call sends to all readers."""
LARGE = 4096
"""Samples of more bytes are also read in place."""
WARM_UP = 0.3
_PATIENCE = 12


def main() -> None:
    """Run the benchmark and print a table for each size."""
    parser = argparse.ArgumentParser(description="One-way latency and CPU of a paced stream.")
    parser.add_argument("--rounds", type=int, default=3)
    parser.add_argument("--seconds", type=float, default=0.5)
    parser.add_argument("--only", default="")
    parser.add_argument("--sizes", type=int, nargs="*", default=list(SIZES), choices=SIZES)
    parser.add_argument("--child", nargs=5, metavar=("ROLE", "WAY", "MODE", "SIZE", "NAME"))
    options = parser.parse_args()
    if options.child:
        role, way, mode, size, name = options.child
        child(role, way, mode, int(size), name, options.seconds)
        return
    versions, ways = _present(options.only.split(",") if options.only else [])
    print(f"Python {sys.version.split()[0]}, {os.uname().machine}, {os.cpu_count()} cores; {', '.join(versions)}")
    with tempfile.TemporaryDirectory() as folder:
        floor = Path(folder, "floor")
        subprocess.run(["gcc", "-O2", "-pthread", "-o", floor, HERE / "peers" / "floor.c"], check=True)
        program = generated.program(Path(folder))
        compiled = {"C": floor, "C++": program, "C++ in place": program}
        if (peer := generated.iceoryx(Path(folder))) is not None:
            compiled["iceoryx 2.0.3, C++"] = peer
        else:
            print("iceoryx in C++ is left out: apt-get install libiceoryx-posh-dev libacl1-dev")
        for size in options.sizes:
            _table(size, SIZES[size], ways, compiled, options.rounds, options.seconds)
    _readers([way for way in MANY if way in ways], options.rounds, options.seconds)


def child(role: str, way: str, mode: str, size: int, name: str, seconds: float) -> None:
    """Run one side of a stream, the sender or the receiver, in this process.

    The receiver prints the median age and its 99th percentile in ns, its CPU time in %, and the number of samples.
    """
    if role == "send":
        send = LIBRARIES[way](role, mode, size, name)
        due = time.monotonic()
        while True:
            now = time.monotonic()
            due = max(due + 1 / SIZES[size], now)
            time.sleep(due - now)
            send(time.monotonic_ns())
    receive = LIBRARIES[way](role, mode, size, name)
    print("ready", flush=True)
    ages: list[int] = []
    end = time.monotonic() + 10
    while receive() is None and time.monotonic() < end:
        pass
    end = time.monotonic() + WARM_UP
    while time.monotonic() < end:
        receive()
    began, used, end = time.monotonic(), _cpu(), time.monotonic() + seconds
    while time.monotonic() < end:
        stamp = receive()
        if stamp is not None:
            ages.append(time.monotonic_ns() - stamp)
    cpu = 100 * (_cpu() - used) / (time.monotonic() - began)
    ages.sort()
    if ages:
        print(statistics.median(ages), ages[len(ages) * 99 // 100], cpu, len(ages), flush=True)
    os._exit(0)


def _table(size: int, rate: int, ways: list[str], compiled: dict[str, Path], rounds: int, seconds: float) -> None:
    rows = [(way, mode) for mode in MODES for way in [*compiled, *ways] if _fits(way, mode, size)]
    results_by_row: dict[tuple[str, str], list[list[float]]] = {row: [] for row in rows}
    for number in range(rounds):
        for row, (way, mode) in enumerate(rows):
            if way in compiled:
                more = ["1"] if way == "C++ in place" else []
                results_by_row[way, mode].append(_floor(compiled[way], mode, size, rate, seconds, *more))
            else:
                name = f"shmgen_latency_{os.getpid()}_{number}_{row}"
                results_by_row[way, mode].append(_measured(way, mode, size, name, seconds))
    print(f"\n{size} bytes at {rate} Hz{'':<24}{'p50 us':>10}{'p99 us':>10}{'CPU %':>8}{'ratio':>8}{'samples':>9}")
    for (way, mode), results in results_by_row.items():
        here = [one for one in results if one]
        if not here:
            print(f"  {mode:<6}{way:<34}{'no sample':>12}")
            continue
        pairs = zip(results, results_by_row["shmgen", mode], strict=True)
        ratio = statistics.median([one[0] / base[0] for one, base in pairs if one and base] or [float("nan")])
        p50, p99, cpu, count = (statistics.median(column) for column in zip(*here, strict=True))
        print(f"  {mode:<6}{way:<34}{p50 / 1000:>10.1f}{p99 / 1000:>10.1f}{cpu:>8.1f}{ratio:>8.2f}{count:>9.0f}")
    for mode in ("spin", "event"):
        pairs = zip(results_by_row["C++", mode], results_by_row["C", mode], strict=True)
        print(f"  {mode:<6}C++ is {statistics.median(ours[0] / floor[0] for ours, floor in pairs):.2f} times C")


def _fits(way: str, mode: str, size: int) -> bool:
    if way.startswith("C") or way.endswith("C++"):
        return mode != "poll" and (way != "C++ in place" or size > LARGE)
    return (
        (size > LARGE or not way.endswith("in place"))
        and size <= LARGEST.get(way, size)
        and (mode != "poll" or way in POLLED)
        and (mode == "event" or way not in WOKEN_ONLY)
    )


def _readers(ways: list[str], rounds: int, seconds: float) -> None:
    """Print the table for 1, 2 and 4 readers.

    A figure is the median of all rounds. With several readers, the figure of a round is the median of its readers.
    """
    results_by_row: dict[tuple[str, int], list[list[float]]] = {(way, many): [] for many in (1, 2, 4) for way in ways}
    for number in range(rounds):
        for row, (way, many) in enumerate(results_by_row):
            name = f"shmgen_readers_{os.getpid()}_{number}_{row}"
            results_by_row[way, many].append(_measured(way, "event", 56, name, seconds, many))
    print(f"\n{'Readers that sleep, 56 bytes at 1000 Hz':<47}{'p50 us':>10}{'p99 us':>10}{'CPU %':>8}{'samples':>17}")
    for (way, many), results in results_by_row.items():
        p50, p99, cpu, count = (statistics.median(column) for column in zip(*filter(None, results), strict=True))
        print(
            f"  {counted(many, 'reader'):<10}{way:<30}{p50 / 1000:>10.1f}{p99 / 1000:>10.1f}{cpu:>8.1f}{count:>17.0f}"
        )


def _measured(way: str, mode: str, size: int, name: str, seconds: float, readers: int = 1) -> list[float]:
    """Run one measurement and return the receiver's figures, as medians if there are several readers.

    Return an empty list if no sample arrived.
    """
    command = [sys.executable, str(HERE / "latency.py"), "--seconds", str(seconds), "--child"]
    ends = [way, mode, str(size), name]
    with ExitStack() as stack:
        stack.callback(remove, name)
        receivers = []
        for _ in range(readers):
            receiver = subprocess.Popen([*command, "receive", *ends], stdout=subprocess.PIPE, stderr=DEVNULL, text=True)
            stack.enter_context(receiver)
            stack.callback(receiver.kill)
            # Kill a receiver that waits for ever because its sender is gone.
            patience = threading.Timer(_PATIENCE + seconds, receiver.kill)
            patience.start()
            stack.callback(patience.cancel)
            receivers.append(receiver.stdout)
        if any(not out or out.readline().strip() != "ready" for out in receivers):
            return []
        sender = stack.enter_context(subprocess.Popen([*command, "send", *ends], stderr=DEVNULL))
        stack.callback(sender.kill)
        medians = [[float(word) for word in out.readline().split()] for out in receivers if out]
        return [statistics.median(column) for column in zip(*filter(None, medians), strict=True)]


def _floor(*command: object) -> list[float]:
    *ages, cpu = map(
        float, subprocess.run(list(map(str, command)), capture_output=True, text=True, check=True).stdout.split()
    )
    ages.sort()
    return [statistics.median(ages), ages[len(ages) * 99 // 100], cpu, len(ages)]


def _present(only: list[str]) -> tuple[list[str], list[str]]:
    """Return the versions of the libraries, or that a library is not installed, and the names of those to measure."""
    versions, ways = [], []
    for way in LIBRARIES:
        if only and way not in only and way != "shmgen":
            continue
        package = networks.PACKAGES.get(way)
        try:
            versions += [f"{package} {importlib.metadata.version(package)}"] if package else []
            ways.append(way)
        except importlib.metadata.PackageNotFoundError:
            versions.append(f"{package} left out (not installed)")
    return versions, ways


def _cpu() -> float:
    used = resource.getrusage(resource.RUSAGE_SELF)
    return used.ru_utime + used.ru_stime


if __name__ == "__main__":
    main()
