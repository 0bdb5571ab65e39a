"""The scripts in benchmarks/ run to their end, with the smallest measurements that they accept."""

from __future__ import annotations

import re
import runpy
import subprocess
import sys
from pathlib import Path

import pytest

from .conftest import REPOSITORY

SCRIPTS = {path.stem: path for path in (REPOSITORY / "benchmarks").glob("*.py") if path.stem != "run"}
SMALL = {"RUNS": 1, "ROUNDS": 3, "MESSAGES": 11, "CYCLES": 20}
ARGUMENTS = {
    "call": ["--rounds", "1", "--calls", "3"],
    "latency": ["--rounds", "1", "--seconds", "0.1", "--sizes", "56", "--only", "UDP"],
}
RUN = f"""
import os, runpy, sys
sys.argv = sys.argv[1:]
sys.path.insert(0, os.path.dirname(sys.argv[0]))
main = runpy.run_path(sys.argv[0])["main"]
main.__globals__.update({{key: value for key, value in {SMALL}.items() if key in main.__globals__}})
main()
"""


@pytest.mark.sample("[call]", "[check]", "[messages]", "[publish]", "[read]")
@pytest.mark.timeout(600)
@pytest.mark.parametrize("name", sorted(SCRIPTS))
def test_benchmark_runs_to_its_end(name: str) -> None:
    command = [sys.executable, "-c", RUN, str(SCRIPTS[name]), *ARGUMENTS.get(name, [])]
    with subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True) as process:
        try:
            output, _ = process.communicate(timeout=500)
        finally:
            process.kill()
    assert process.returncode == 0, output
    assert re.search(r"\d", output), output
    assert not list(Path("/dev/shm").glob(f"*benchmark_{process.pid}*"))


def test_page_shows_the_output_or_one_paragraph() -> None:
    with_tables = runpy.run_path(str(REPOSITORY / "benchmarks" / "run.py"))["with_tables"]
    page = "<!-- bench: a -->\nold\n<!-- end -->\n<!-- bench: b 56 bytes -->\nold\n<!-- end -->\n"
    updated = with_tables(page, {"a": "one\n\ntwo", "b": "first\n\n56 bytes at\n  7\n\n320 bytes"})
    assert updated == (
        "<!-- bench: a -->\n```\none\n\ntwo\n```\n<!-- end -->\n"
        "<!-- bench: b 56 bytes -->\n```\n56 bytes at\n  7\n```\n<!-- end -->\n"
    )
