"""Runs all benchmarks one after another. With --docs, writes their output into docs/performance.md.

In the page, the output of a benchmark is between `<!-- bench: NAME -->` and `<!-- end -->`. If a text follows NAME, the
page has only the first paragraph that begins with this text. The line after `<!-- bench -->` contains the date and the
machine.
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
    """Run a benchmark, print its output at once, and return the output. Raises SystemExit if it fails."""
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
    """Return the page with the new output of the benchmarks. Raises KeyError if the page names an unknown benchmark."""
    load = ", ".join(f"{load:.1f}" for load in os.getloadavg())
    where = f"Python {platform.python_version()}, Linux {platform.release()}, {os.cpu_count()} cores, load {load}"
    page = re.sub(r"(?<=<!-- bench -->\n).*(?=\n)", f"{datetime.date.today()}: {where}.", page)
    return re.sub(
        r"(?s)(<!-- bench: (\w+)(?: ([^>]*?))? -->\n).*?(<!-- end -->)",
        lambda match: f"{match[1]}```\n{_paragraph(printed[match[2]], match[3])}\n```\n{match[4]}",
        page,
    )


def _paragraph(text: str, start: str | None) -> str:
    """Return the first paragraph that begins with `start`, or the whole text without `start`."""
    return next(part for part in text.split("\n\n") if part.startswith(start)) if start else text


if __name__ == "__main__":
    main()
