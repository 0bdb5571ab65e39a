"""Times `shmgen check` of 200 messages with nothing to find: against a bare Python start, and against generating them.

All are run in turn; a ratio is the median of those of the runs beside each other. Wanted: at most 4x the start, and
under a tenth of generating. The first check of a folder, and one after a change, is made in full: at most 35x.
"""

from __future__ import annotations

import os
import shutil
import statistics
import subprocess
import sys
import tempfile
import time
from collections.abc import Sequence
from pathlib import Path

RUNS = 15
MESSAGES = 200
SHMGEN = str(Path(sys.executable).parent / "shmgen")


def main() -> None:
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        environment = {**os.environ, "XDG_CACHE_HOME": str(folder / "cache")}
        environment.pop("PYTHONDONTWRITEBYTECODE", None)
        work = workspace(folder / "work")
        commands = {
            "bare python start": [sys.executable, "-c", "pass"],
            "check, clean before": [SHMGEN, "check"],
            "check in full": [SHMGEN, "check", "--json"],
            "generate, nothing to do": [SHMGEN, "generate", "--quiet"],
            "generate, all anew": [SHMGEN, "generate", "--quiet", "--output", str(folder / "anew")],
        }
        run(commands["generate, nothing to do"], work, environment)
        time.sleep(0.1)
        times: dict[str, list[float]] = {key: [] for key in commands}
        for number in range(RUNS + 1):
            for key, command in commands.items():
                shutil.rmtree(folder / "anew", ignore_errors=True)
                seconds = run(command, work, environment)
                if number:  # the first round fills the caches
                    times[key].append(seconds)
        medians = {key: statistics.median(found) for key, found in times.items()}
        files = sum(path.is_file() for path in (work / "generated").rglob("*"))
        print(f"{MESSAGES} messages, {files} generated files")
        floors = times["bare python start"]
        for key, found in times.items():
            ratio = statistics.median(one / floor for one, floor in zip(found, floors, strict=True))
            print(f"{key:<26}{medians[key] * 1e3:8.1f} ms  {ratio:6.1f}x")
        share = medians["check, clean before"] / medians["generate, all anew"]
        print(f"wanted: at most 4x for the second line, 35x for the third; {share:.2f} of generating (under 0.10)")


def workspace(folder: Path) -> Path:
    """Each message holds some numbers, a sequence and the one before it."""
    place = folder / "msgs" / "many_msgs" / "msg"
    place.mkdir(parents=True)
    for number in range(MESSAGES):
        inner = f"Many{number - 1} inner\n" if number % 10 else ""
        fields = "".join(f"float64 value{index}  # [m] of axis {index}\n" for index in range(number % 7 + 1))
        (place / f"Many{number}.msg").write_text(f"# Message {number}.\n{fields}int32[<=8] counts\n{inner}")
    (folder / "shmgen.toml").write_text('messages = ["many_msgs"]\npath = ["msgs"]\n')
    return folder


def run(command: Sequence[str], folder: Path, environment: dict[str, str]) -> float:
    """Seconds from start to end of a process that must succeed."""
    start = time.perf_counter()
    done = subprocess.run(command, cwd=folder, env=environment, capture_output=True, text=True, check=False)
    if done.returncode != 0:
        sys.exit(f"{' '.join(command)}\n{done.stdout}{done.stderr}")
    return time.perf_counter() - start


if __name__ == "__main__":
    main()
