"""Explores all scenes and all planted faults, and prints the results: `make explore`.

    python -m tests.explorer [--instead FOLDER] [--seconds N] [--faults] [NAME ...]

With names, only these scenes are explored, and each step of a failed schedule is printed. `--instead` replaces
generated headers and Structured Text by the files of a folder that have the same names. You can thus try a change of
the protocol before you implement it.
"""

from __future__ import annotations

import argparse
import sys
import tempfile
from pathlib import Path
from typing import Any

from .build import build, explore, generate, missing, replace_files
from .faults import FAULTS
from .scenes import SCENES


def main() -> int:
    parser = argparse.ArgumentParser(prog="python -m tests.explorer")
    parser.add_argument("--instead", type=Path)
    parser.add_argument("--seconds", type=float, default=600, help="the limit of each scene")
    parser.add_argument("--faults", action="store_true", help="also explore the planted faults")
    parser.add_argument("names", nargs="*", metavar="NAME")
    options = parser.parse_args()
    if tools := missing():
        print(f"not installed: {', '.join(tools)}")
        return 1
    if unknown := set(options.names) - set(SCENES):
        print(f"unknown scene: {', '.join(sorted(unknown))}; known scenes: {', '.join(SCENES)}")
        return 1
    with tempfile.TemporaryDirectory(prefix="shmgen-explorer-") as name:
        failures = _scenes(options, Path(name)) + (_faults(options, Path(name)) if options.faults else 0)
    print("as expected" if not failures else f"{failures} not as expected")
    return bool(failures)


def format_verdict(verdict: dict[str, Any]) -> str:
    """Return a result as one line of text."""
    result = verdict["found"] or ("no error" if verdict["complete"] else "no error found, search not finished")
    return f"{result}, {verdict['schedules']:,} schedules, {verdict['seconds']:.2f} s"


def _scenes(options: argparse.Namespace, folder: Path) -> int:
    programs = {}
    for sync in ("lock", "sequence"):
        texts = generate(folder / sync, sync)
        programs[sync] = build(folder / sync, replace_files(texts, options.instead) if options.instead else texts)
    failures = 0
    for scene in [SCENES[name] for name in options.names or SCENES]:
        verdict, steps = explore(programs[scene.sync], ["bits=26", *scene.arguments], options.seconds)
        schedule = f" [{verdict['schedule']}]" if verdict["found"] else ""
        print(f"{scene.name}: {format_verdict(verdict)}{schedule}", flush=True)
        failures += bool(verdict["found"]) or not verdict["complete"]
        if options.names:
            print(steps)
    return failures


def _faults(options: argparse.Namespace, folder: Path) -> int:
    texts = generate(folder)
    failures = 0
    for fault in FAULTS:
        program = build(folder / "fault", fault.planted(texts))
        verdict, _ = explore(program, SCENES[fault.scene].arguments, options.seconds)
        print(f"{fault.name}: {format_verdict(verdict)}{f' ({fault.reason})' if fault.reason else ''}", flush=True)
        failures += not (verdict["found"] or fault.reason)
    return failures


if __name__ == "__main__":
    sys.exit(main())
