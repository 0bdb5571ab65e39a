"""Times how fast shmgen and rosbags parse definitions: the same .msg files, already in memory. Prints medians.

Argument: a folder with <distribution>/<package>/msg/*.msg. Name the distribution of ROS 1 noetic. Without an argument
the built-in store of Jazzy is parsed.
"""

from __future__ import annotations

import statistics
import sys
import time
from pathlib import Path

from rosbags.typesys import get_types_from_msg

from shmgen.core.diagnostics import Report
from shmgen.core.model import TypeName
from shmgen.definitions import store
from shmgen.definitions.catalogue import Definition
from shmgen.definitions.parser import parse

RUNS = 5


def main() -> None:
    definitions = of_folder(Path(sys.argv[1])) if len(sys.argv) > 1 else of_store()
    ours, theirs = [], []
    for _ in range(RUNS):
        start = time.process_time()
        for name, text, distribution in definitions:
            parse(Definition(name, "", "", text), text, store.dialect(distribution), Report())
        middle = time.process_time()
        for name, text, _ in definitions:
            get_types_from_msg(text, str(name))
        ours.append(middle - start)
        theirs.append(time.process_time() - middle)
    mine, floor = statistics.median(ours), statistics.median(theirs)
    print(f"rosbags {floor * 1e3:8.1f} ms   1      {len(definitions)} .msg files")
    print(f"shmgen  {mine * 1e3:8.1f} ms   {mine / floor:.2f}x (wanted: at most 2x), with places, comments and ranges")


def of_folder(folder: Path) -> list[tuple[TypeName, str, str]]:
    files = sorted(folder.glob("*/*/msg/*.msg"))
    return [(TypeName(file.parts[-3], "msg", file.stem), file.read_text(), file.parts[-4]) for file in files]


def of_store() -> list[tuple[TypeName, str, str]]:
    packages = store.catalogue("jazzy")
    messages = [
        one for (package,) in packages.values() for one in package.definitions.values() if one.name.kind == "msg"
    ]
    return [(one.name, str(one.content), "jazzy") for one in messages]


if __name__ == "__main__":
    main()
