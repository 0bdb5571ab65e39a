"""Turns a library of compile_st into a process that runs one block in a cycle, as a task of a PLC does.

    python -m tests.softplc.task FOLDER/plc.so PRG_Main --period 0.001 [--set xEnable=true ...]

Prints `running` after the first cycle. Ends when it is killed.
"""

from __future__ import annotations

import argparse
import json
from pathlib import Path

from tests.softplc.plc import Plc


def main() -> None:
    """Reads the command line."""
    parser = argparse.ArgumentParser()
    parser.add_argument("library", type=Path)
    parser.add_argument("block")
    parser.add_argument("--period", type=float, default=0.001, help="seconds")
    parser.add_argument("--set", nargs="*", default=[], help='inputs, values as in JSON: xEnable=true sTopic=\'"/a"\'')
    arguments = parser.parse_args()
    run(Plc.load(arguments.library), arguments.block, arguments.period, arguments.set)


def run(plc: Plc, name: str, period: float, settings: list[str]) -> None:
    """For ever."""
    block = plc.block(name)
    for setting in settings:
        variable, _, value = setting.partition("=")
        setattr(block, variable, json.loads(value))
    block()
    print("running", flush=True)
    block.run(period, 2**63)


if __name__ == "__main__":
    main()
