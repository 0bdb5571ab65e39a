"""Test each folder of tests/errors: a user's mistake, the command, and the reported error.

`command` is the command line, `expected.txt` the expected stderr, `inputs.py` creates input files, and `environment`
contains environment variables.
"""

from __future__ import annotations

import re
import shlex
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

from shmgen.core.diagnostics import CODES

from ..conftest import REPOSITORY
from ..support.command import Result, run, tree

CASES = sorted(path for path in (REPOSITORY / "tests" / "errors").iterdir() if path.is_dir())


@pytest.mark.parametrize("case", CASES, ids=lambda case: case.name)
def test_expected_error(case: Path, tmp_path: Path, update_golden: bool, monkeypatch: pytest.MonkeyPatch) -> None:
    folder = tmp_path / "work"
    ignore = shutil.ignore_patterns("command", "environment", "expected.txt", "__pycache__")
    shutil.copytree(case, folder, ignore=ignore)
    if (case / "environment").is_file():
        for variable in (case / "environment").read_text().splitlines():
            monkeypatch.setenv(*variable.split("=", 1))
    if (folder / "inputs.py").is_file():
        run_command(["python", "inputs.py"], folder)
    before = tree(folder)
    result = run_command(shlex.split((case / "command").read_text()), folder)
    stderr = re.sub(r"; existing: .*", "; there are none", result.stderr)  # regions of other tests
    result = result._replace(stderr=stderr.replace(sys.prefix, "/opt/venv"))
    if update_golden:
        (case / "expected.txt").write_text(result.stderr, encoding="utf-8")
    assert result.stderr == (case / "expected.txt").read_text(encoding="utf-8")
    assert f"error[{case.name.partition('_')[0]}]: " in result.stderr
    assert (result.code, result.stdout) == (1, "")
    assert tree(folder) == before


def test_examples_of_the_docs_occur_in_the_cases() -> None:
    docs = (REPOSITORY / "src" / "shmgen" / "diagnostics.md").read_text(encoding="utf-8")
    examples = re.findall(r"^```\n([^\n`]+: error\[.+?)^```$", docs, re.MULTILINE | re.DOTALL)
    assert len(examples) == len(CODES)
    outputs = "".join((case / "expected.txt").read_text(encoding="utf-8") for case in CASES)
    assert [example for example in examples if example not in outputs] == []


def run_command(command: list[str], folder: Path) -> Result:
    if command[0] == "shmgen":
        return run(command[1:], folder)
    assert command[0] == "python"
    done = subprocess.run([sys.executable, "-B", *command[1:]], cwd=folder, capture_output=True, text=True, check=False)
    return Result(done.returncode, done.stdout, done.stderr)
