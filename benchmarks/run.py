"""Runs all benchmarks, one after the other: they must not meet on one machine. With --docs, docs/ has it all.

There each stands between `<!-- bench: NAME -->` and `<!-- end -->`, the day and the machine behind `<!-- bench -->`.
"""

from __future__ import annotations

import datetime
import os
import platform
import re
import subprocess
import sys
from pathlib import Path

HERE = Path(__file__).parent
PAGE = HERE.parent / "docs" / "performance.md"


def main() -> None:
    printed = {script.stem: run(script) for script in sorted(HERE.glob("*.py")) if script.name != Path(__file__).name}
    if "--docs" in sys.argv:
        PAGE.write_text(with_tables(PAGE.read_text(encoding="utf-8"), printed), encoding="utf-8")


def run(script: Path) -> str:
    """What it prints, which is seen at once too."""
    print(f"\n=== {script.name}", flush=True)
    lines = []
    with subprocess.Popen([sys.executable, str(script)], stdout=subprocess.PIPE, text=True) as process:
        for line in process.stdout or ():
            print(line, end="", flush=True)
            lines.append(line)
    if process.returncode:
        sys.exit(f"{script.name} ended with {process.returncode}")
    return "".join(lines).strip("\n")


def with_tables(page: str, printed: dict[str, str]) -> str:
    """Raises KeyError: the page wants the table of a benchmark that there is not."""
    load = ", ".join(f"{load:.1f}" for load in os.getloadavg())
    where = f"Python {platform.python_version()}, Linux {platform.release()}, {os.cpu_count()} cores, load {load}"
    page = re.sub(r"(?<=<!-- bench -->\n).*(?=\n)", f"{datetime.date.today()}: {where}.", page)
    return re.sub(
        r"(?s)(<!-- bench: (\w+) -->\n).*?(<!-- end -->)",
        lambda found: f"{found[1]}```\n{printed[found[2]]}\n```\n{found[3]}",
        page,
    )


if __name__ == "__main__":
    main()
