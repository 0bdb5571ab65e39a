"""Runs a PLC as hardware of ros2_control at 1 kHz, then kills either side and measures how soon the other side notices.

    python -m tests.rigs.load_control --seconds 60 --kills 20

Uses the package that `-t ros2_control` generates, in the ResourceManager of hardware_interface. It has six joints; each
cycle is read, controller, write. The PLC is a process in Python that answers each command. The exit code is 1 if a
cycle failed or a value was wrong.
"""

from __future__ import annotations

import argparse
import sys
import tempfile
import time
from pathlib import Path

from ..ros2.test_control import SAFE, Cell, read_result, read_until
from .load_bridge import busy, resident

STALE = 0.1
"""The timeout of a heartbeat in seconds on both sides, which is the default of the package."""


def main() -> None:
    """Run the loop without faults, then the kills, and print the results of both."""
    parser = argparse.ArgumentParser(description="A PLC as hardware of ros2_control at 1 kHz, and kills.")
    parser.add_argument("--seconds", type=int, default=60)
    parser.add_argument("--kills", type=int, default=20, help="of either side")
    arguments = parser.parse_args()
    with tempfile.TemporaryDirectory() as folder:
        cell = Cell(Path(folder))
        try:
            good = run_steadily(cell, arguments.seconds)
            for side, kill in (("PLC", kill_plc), ("controller", kill_controller)):
                took = sorted(1e3 * kill(cell) for _ in range(arguments.kills))
                middle, worst = took[len(took) // 2], took[-1]
                print(f"{side} killed {len(took)} times: known after {middle:.0f} ms, at worst {worst:.0f}", flush=True)
        finally:
            cell.clean_up()
    sys.exit(0 if good else 1)


def run_steadily(cell: Cell, seconds: int) -> bool:
    cell.plc()
    controller = cell.controller(1000 * seconds)
    read_until(controller, "running")
    begun, before = time.monotonic(), busy(controller.pid)
    time.sleep(seconds - 1)
    cpu, memory = (busy(controller.pid) - before) / (time.monotonic() - begun), resident(controller.pid)
    stats = read_result(controller)
    p50, p99, worst = stats["cycle_us"]
    print(
        f"{stats['good_cycles']:,} cycles at 1 kHz, {stats['new_positions']:,} with new positions, "
        f"{stats['late_positions']:,} with positions older than 20 ms, {stats['wrong_positions']} wrong positions; "
        f"read + write p50 {p50} p99 {p99} worst {worst} us, {100 * cpu:.0f} % of a core, {memory} MiB",
        flush=True,
    )
    cell.kill()
    return stats["good_cycles"] == 1000 * seconds and not stats["wrong_positions"]


def kill_plc(cell: Cell) -> float:
    """Measure the seconds from a kill of the PLC until the controller's `read` fails. Then the safe command is sent."""
    plc, controller = cell.plc(), cell.controller(60_000, SAFE)
    read_until(controller, "running")
    time.sleep(0.5)
    plc.kill()
    begun = time.monotonic()
    assert read_result(controller)["failed_call"] == "read"
    took = time.monotonic() - begun
    cell.kill()
    return took


def kill_controller(cell: Cell) -> float:
    """Measure the seconds from a kill of the controller until the PLC's subscriber is stale."""
    cell.plc()
    controller = cell.controller(60_000)
    read_until(controller, "running")
    with cell.commands() as reader:
        while reader.wait(0.5) is None:
            pass
        assert not reader.is_stale(STALE)
        controller.kill()
        begun = time.monotonic()
        while not reader.is_stale(STALE):
            time.sleep(0.001)
    took = time.monotonic() - begun
    cell.kill()
    return took


if __name__ == "__main__":
    main()
