"""Explores all scenes and all planted faults, and prints the results: `make explore`.

    python -m tests.explorer [--instead FOLDER] [--seconds N] [--faults] [NAME ...]

With names, only these scenes are explored, and each step of a found schedule is printed. `--instead` replaces generated
headers and Structured Text by the files of a folder that have the same names. A change of the protocol can thus be
tried before it is implemented.
"""

from __future__ import annotations

import argparse
import sys
import tempfile
from pathlib import Path
from typing import Any

from .build import build, explore, generated, instead, missing
from .faults import FAULTS
from .scenes import SCENES


def main() -> int:
    parser = argparse.ArgumentParser(prog="python -m tests.explorer")
    parser.add_argument("--instead", type=Path)
    parser.add_argument("--seconds", type=float, default=600, help="for each scene, at most")
    parser.add_argument("--faults", action="store_true", help="the planted faults as well")
    parser.add_argument("names", nargs="*", metavar="NAME")
    options = parser.parse_args()
    if tools := missing():
        print(f"not here: {', '.join(tools)}")
        return 1
    if unknown := set(options.names) - set(SCENES):
        print(f"no such scene: {', '.join(sorted(unknown))}; there are: {', '.join(SCENES)}")
        return 1
    with tempfile.TemporaryDirectory(prefix="shmgen-explorer-") as name:
        wrong = _scenes(options, Path(name)) + (_faults(options, Path(name)) if options.faults else 0)
    print("as it should be" if not wrong else f"{wrong} not as they should be")
    return bool(wrong)


def said(verdict: dict[str, Any]) -> str:
    """Return a result as one line of text."""
    what = verdict["found"] or ("holds" if verdict["complete"] else "nothing found, not complete")
    return f"{what}, {verdict['schedules']:,} schedules, {verdict['seconds']:.2f} s"


def _scenes(options: argparse.Namespace, folder: Path) -> int:
    programs = {}
    for sync in ("lock", "sequence"):
        texts = generated(folder / sync, sync)
        programs[sync] = build(folder / sync, instead(texts, options.instead) if options.instead else texts)
    wrong = 0
    for scene in [SCENES[name] for name in options.names or SCENES]:
        verdict, told = explore(programs[scene.sync], ["bits=26", *scene.arguments], options.seconds)
        where = f" [{verdict['schedule']}]" if verdict["found"] else ""
        print(f"{scene.name}: {said(verdict)}{where}", flush=True)
        wrong += bool(verdict["found"]) or not verdict["complete"]
        if options.names:
            print(told)
    return wrong


def _faults(options: argparse.Namespace, folder: Path) -> int:
    texts = generated(folder)
    wrong = 0
    for fault in FAULTS:
        program = build(folder / "fault", fault.planted(texts))
        verdict, _ = explore(program, SCENES[fault.scene].arguments, options.seconds)
        print(f"{fault.name}: {said(verdict)}{f' ({fault.reason})' if fault.reason else ''}", flush=True)
        wrong += not (verdict["found"] or fault.reason)
    return wrong


if __name__ == "__main__":
    sys.exit(main())
