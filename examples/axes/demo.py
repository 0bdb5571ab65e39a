"""Moves six axes at 1 kHz, kills the controller and the PLC in turn, and prints how fast the axes stop.

demo.py --seconds 60 --kills 20
"""

from __future__ import annotations

import argparse
import shutil
import statistics
import subprocess
import sys
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

HERE = Path(__file__).parent
sys.path.insert(0, str(HERE.parent))

from stage import Cell, cell  # noqa: E402 the module is in examples/

LIMIT = 1.0
"""Maximum seconds from the kill to standstill: 0.05 for the timeout, 0.1 for the ramp, the rest for a busy machine."""


class Watch:
    """Receives the state of the six axes, to measure with this process's clock how fast the axes stop."""

    def __init__(self, subscriber: Any) -> None:
        self.subscriber = subscriber

    def until(self, condition: Callable[[Any], bool], what: str, seconds: float = 20.0) -> Any:
        """Return the first state of the axes that satisfies `condition`. Raises SystemExit after `seconds`."""
        deadline = time.monotonic() + seconds
        while time.monotonic() < deadline:
            state = self.subscriber.wait(0.1)
            if state is not None and condition(state):
                return state
        sys.exit(f"{seconds:g} s and the axes did not report {what}")


def main(seconds: float, kills: int) -> int:
    """Run the demo. Return 0 if the axes stopped in time after each kill and the last controller succeeded."""
    if not shutil.which("g++"):
        sys.exit("g++ is not installed")
    with cell(HERE, "blark") as here:
        here.generate()
        program = here.folder / "controller"
        print("\n$ g++ -std=c++17 -O2 -I generated/cpp controller.cpp -o controller", flush=True)
        flags = ["-std=c++17", "-O2", "-Wall", "-Wextra", "-Werror", f"-I{here.folder}/cpp"]
        subprocess.run(["g++", *flags, HERE / "controller.cpp", "-o", program, "-lrt", "-lpthread"], check=True)
        sys.path.insert(0, f"{here.folder}/python")
        from shm_msgs.axes_msgs.msg import AxesStateSubscriber  # type: ignore[import-not-found]

        with AxesStateSubscriber("/axes/state") as subscriber:
            return _run(here, Watch(subscriber), program, seconds, kills)


def _run(here: Cell, watch: Watch, program: Path, seconds: float, kills: int) -> int:
    plc = here.start_plc("PRG_Axes")
    took = []
    for kill in range(kills):
        with subprocess.Popen([program, "600"], stdout=subprocess.DEVNULL) as controller:
            try:
                watch.until(_is_moving, "a motion")
                time.sleep(0.05 * kill)
            finally:
                controller.kill()
                killed = time.monotonic()
        state = watch.until(lambda state: bool(state.state == state.FAULT), "a safe stop")
        took.append(time.monotonic() - killed)
        print(
            f"   controller killed: standstill {1000 * took[-1]:.0f} ms later; by the PLC's clock {state.stop_delay} ms"
            f" to the start of the stop, {state.standstill_delay} ms to standstill",
            flush=True,
        )
    with subprocess.Popen([program, "600"], stdout=subprocess.DEVNULL) as controller:
        try:
            watch.until(_is_moving, "a motion after a reset")
            plc.kill()
            plc.wait()
            killed = time.monotonic()
            here.run_plc("PRG_Axes")
            watch.until(_is_moving, "a motion after a restart of the PLC")
            print(
                f"   PLC killed and started again: the axes moved again {time.monotonic() - killed:.1f} s later",
                flush=True,
            )
        finally:
            controller.kill()
    print(f"\n$ ./controller {seconds:g}", flush=True)
    controller = subprocess.Popen([program, str(seconds)], stdout=subprocess.PIPE, text=True)
    output = controller.communicate()[0]
    print("".join(f"   {line}\n" for line in output.splitlines()), end="", flush=True)
    late = [delay for delay in took if delay > LIMIT]
    if took:
        middle, most = 1000 * statistics.median(took), 1000 * max(took)
        print(f"   {len(took)} safe stops: standstill {middle:.0f} ms (median), {most:.0f} ms (longest) after the kill")
    return 1 if late or controller.returncode else 0


def _is_moving(state: Any) -> bool:
    return bool(state.state == state.ENABLED and max(map(abs, state.velocity)) > 0.5)


if __name__ == "__main__":
    parser = argparse.ArgumentParser()
    parser.add_argument("--seconds", type=float, default=3.0)
    parser.add_argument("--kills", type=int, default=2)
    options, _ = parser.parse_known_args()
    sys.exit(main(options.seconds, options.kills))
