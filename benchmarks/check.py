"""Times `shmgen check` and `generate` over 200 messages, and short commands, compared with the start of bare Python.

The runs have nothing to do, everything to do, or one changed message. All commands run in turn. A ratio is the median
of the ratios of adjacent runs. The first check of a folder, and each check after a change, is a full check.
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


WANTED = {
    "check, clean before": 4,
    "check in full": 30,
    "generate, nothing to do": 4,
    "shmgen --version": 3,
    "completion of a command": 3,
    "import shmgen.runtime": 2,
}
"""Target ratios to a bare Python start. A program that only imports click has 1.75."""
WANTED_MS = {"generate, one changed": 500}


def main() -> None:
    with tempfile.TemporaryDirectory(dir="/dev/shm") as name:  # in memory, to exclude the time of the disk
        folder = Path(name)
        environment = {**os.environ, "XDG_CACHE_HOME": str(folder / "cache")}
        environment.pop("PYTHONDONTWRITEBYTECODE", None)
        tab = environment | {"_SHMGEN_COMPLETE": "bash_complete", "COMP_WORDS": "shmgen gen", "COMP_CWORD": "1"}
        work, other = workspace(folder / "work"), workspace(folder / "other")
        commands: dict[str, tuple[list[str], Path, dict[str, str]]] = {
            "bare python start": ([sys.executable, "-c", "pass"], work, environment),
            "check, clean before": ([SHMGEN, "check"], work, environment),
            "check in full": ([SHMGEN, "check", "--json"], work, environment),
            "generate, nothing to do": ([SHMGEN, "generate", "--quiet"], work, environment),
            "generate, one changed": ([SHMGEN, "generate", "--quiet"], other, environment),
            "generate, all anew": ([SHMGEN, "generate", "--quiet", "-o", str(folder / "anew")], work, environment),
            "shmgen --version": ([SHMGEN, "--version"], work, environment),
            "completion of a command": ([SHMGEN], work, tab),
            "import shmgen.runtime": ([sys.executable, "-c", "import shmgen.runtime"], work, environment),
        }
        for place in (work, other):
            run([SHMGEN, "generate", "--quiet"], place, environment)
        time.sleep(0.1)
        times: dict[str, list[float]] = {key: [] for key in commands}
        for number in range(RUNS + 1):
            shutil.rmtree(folder / "anew", ignore_errors=True)
            message = other / "msgs" / "many_msgs" / "msg" / f"Many{MESSAGES // 3}.msg"
            message.write_text(f"{message.read_text()}uint8 X{number} = {number}\n")
            for key, command in commands.items():
                seconds = run(*command)
                if number:  # the first round only fills the caches
                    times[key].append(seconds)
        files = sum(path.is_file() for path in (work / "generated").rglob("*"))
        print(f"{MESSAGES} messages, {files} generated files")
        floors = times["bare python start"]
        for key, seconds in times.items():
            ratio = statistics.median(one / floor for one, floor in zip(seconds, floors, strict=True))
            goal = f"  (wanted: at most {WANTED[key]}x)" if key in WANTED else ""
            goal = f"  (wanted: at most {WANTED_MS[key]} ms)" if key in WANTED_MS else goal
            print(f"{key:<26}{statistics.median(seconds) * 1e3:8.1f} ms  {ratio:6.1f}x{goal}")


def workspace(folder: Path) -> Path:
    """Create a package of messages. Each contains numbers, a sequence and, in most cases, the previous message."""
    place = folder / "msgs" / "many_msgs" / "msg"
    place.mkdir(parents=True)
    for number in range(MESSAGES):
        inner = f"Many{number - 1} inner\n" if number % 10 else ""
        fields = "".join(f"float64 value{index}  # [m] of axis {index}\n" for index in range(number % 7 + 1))
        (place / f"Many{number}.msg").write_text(f"# Message {number}.\n{fields}int32[<=8] counts\n{inner}")
    (folder / "shmgen.toml").write_text('messages = ["many_msgs"]\npath = ["msgs"]\n')
    return folder


def run(command: Sequence[str], folder: Path, environment: dict[str, str]) -> float:
    """Run a process that must succeed, and return its duration in seconds."""
    start = time.perf_counter()
    done = subprocess.run(command, cwd=folder, env=environment, capture_output=True, text=True, check=False)
    if done.returncode != 0:
        sys.exit(f"{' '.join(command)}\n{done.stdout}{done.stderr}")
    return time.perf_counter() - start


if __name__ == "__main__":
    main()
