"""Runs the programs of a compiled PLC in a cycle, as a task of a PLC does, in a process of its own.

    python -m tests.softplc.task FOLDER/plc.so PRG_Ros PRG_Own --period 0.001 [--set xEnable=true ...]

Prints `running` after the first cycle. Ends when it is killed.
"""

from __future__ import annotations

import argparse
import json
from pathlib import Path

from tests.softplc.plc import Plc


def main() -> None:
    """Run the programs that the command line names."""
    parser = argparse.ArgumentParser()
    parser.add_argument("library", type=Path)
    parser.add_argument("programs", nargs="+", help="or blocks, in the order of their calls")
    parser.add_argument("--period", type=float, default=0.001, help="seconds")
    parser.add_argument("--set", nargs="*", default=[], help="inputs, values as in JSON: xEnable=true sTopic='\"/a\"'")
    arguments = parser.parse_args()
    run(Plc.load(arguments.library), arguments.programs, arguments.period, arguments.set)


def run(plc: Plc, names: list[str], period: float, settings: list[str]) -> None:
    """Run the programs without end. `settings` are inputs of the first program."""
    blocks = [plc.block(name) for name in names]
    for setting in settings:
        variable, _, value = setting.partition("=")
        setattr(blocks[0], variable, json.loads(value))
    plc.run(blocks, period, 1)
    print("running", flush=True)
    plc.run(blocks, period, 2**63)


if __name__ == "__main__":
    main()
