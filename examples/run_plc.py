"""Run a PLC program in the stand-in for a PLC, and print variables as the online view of an IDE does.

    python examples/run_plc.py --watch GVL_Ros.cell_job.Msg.speed             # print changes until Ctrl+C
    python examples/run_plc.py --watch GVL_Ros.cell_job.xValid --cycles 200   # run 200 cycles, then print once

The current folder contains `generated/` and the PLC programs, one or more files `*.st`. Each 10 ms, the stand-in calls
PRG_Ros and then these programs. It is made for tests and demos, and is not a PLC.
"""

from __future__ import annotations

import argparse
import re
import sys
from collections.abc import Sequence
from contextlib import suppress
from pathlib import Path
from typing import TYPE_CHECKING, Any

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))

if TYPE_CHECKING:
    from tests.softplc.plc import Plc

PERIOD = 0.01
"""The period of a cycle in seconds."""


def main() -> None:
    parser = argparse.ArgumentParser(description="Run the PLC program in the current folder without a PLC.")
    parser.add_argument("--watch", action="append", default=[], metavar="VARIABLE", help="may be repeated")
    parser.add_argument("--cycles", type=int, help="run this many cycles of 10 ms; by default until Ctrl+C")
    arguments = parser.parse_args()
    own, generated = sorted(Path().glob("*.st")), sorted(Path("generated/st").rglob("*.st"))
    if not generated:
        raise SystemExit("There is no generated/st in this folder. Run `shmgen generate` first.")
    from tests.softplc import compile_st

    plc = compile_st({str(path): path.read_text() for path in (*generated, *own)})
    names = ["PRG_Ros", *re.findall(r"^PROGRAM (\w+)", "\n".join(path.read_text() for path in own), re.MULTILINE)]
    run(plc, {name: plc.block(name) for name in names}, arguments.watch, arguments.cycles)


def run(plc: Plc, programs: dict[str, Any], watched: Sequence[str], cycles: int | None) -> None:
    """Run the programs, and print each watched variable at the end, or on each change if `cycles` is None."""
    blocks = list(programs.values())
    if cycles is not None:
        plc.run(blocks, PERIOD, cycles)
        for name in watched:
            print(f"{name:40} {value(plc, programs, name)}")
        return
    last: dict[str, str] = {}
    while True:
        plc.run(blocks, PERIOD, 10)
        for name in watched:
            if last.get(name) != (new := value(plc, programs, name)):
                print(f"{name:40} {new}", flush=True)
                last[name] = new


def value(plc: Plc, programs: dict[str, Any], name: str) -> str:
    """Return a variable such as `GVL_Ros.cell_job.Msg.speed` or `PRG_Cell.uiCount` as an IDE shows it."""
    first, *rest = re.findall(r"\w+", name)
    try:
        node = programs[first] if first in programs else plc.globals(first)
        for part in rest:
            node = node[int(part)] if part.isdigit() else getattr(node, part)
    except (AttributeError, IndexError, KeyError) as error:
        raise SystemExit(f"{name} does not exist: {error}") from None
    match node:
        case bool():
            return str(node).upper()
        case str() if "." not in node and node.isupper():
            return node
        case str():
            return f"'{node}'"
    return str(node)


if __name__ == "__main__":
    with suppress(KeyboardInterrupt):
        main()
