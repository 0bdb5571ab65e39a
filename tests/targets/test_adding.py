"""docs/adding-a-target.md, done: the target it adds keeps the contract, and its offsets are those of the layouts."""

from __future__ import annotations

import os
import re
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

from shmgen.config import Config
from shmgen.generator import pipeline

from ..conftest import REPOSITORY
from ..support import pages

PAGE = REPOSITORY / "docs" / "adding-a-target.md"
TYPES = ("geometry_msgs/PoseStamped", "sensor_msgs/Range", "std_msgs/Empty", "std_msgs/ColorRGBA")


@pytest.fixture(scope="module")
def added(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A copy of the repository with the target of the page."""
    folder = pages.copy(tmp_path_factory.mktemp("added"))
    assert {path.suffix for path in pages.follow(PAGE, "rust_target", folder)} == {".py", ".j2"}
    return folder


def run(folder: Path, *arguments: str, inside: Path | None = None) -> str:
    environment = {**os.environ, "PYTHONPATH": f"{folder / 'src'}:{folder}"}
    command = [sys.executable, "-m", *arguments]
    done = subprocess.run(command, cwd=inside or folder, env=environment, capture_output=True, text=True, check=False)
    assert done.returncode == 0, (done.stdout + done.stderr)[-4000:]
    return done.stdout


@pytest.mark.slow
def test_it_keeps_the_contract(added: Path) -> None:
    contract = ("tests/targets/test_contract.py", "-k", "rust or stands_behind", "-n0", "-p", "no:cacheprovider")
    assert re.search(r"\b9 passed", run(added, "pytest", *contract, "-o", "addopts="))


@pytest.mark.slow
def test_it_follows_the_rules_of_the_house(added: Path) -> None:
    run(added, "ruff", "check", "--no-cache", "src/shmgen/targets", "tests/support")
    run(added, "ruff", "format", "--check", "--no-cache", "src/shmgen/targets", "tests/support")
    run(added, "mypy", "--cache-dir", str(added / "cache"), "src/shmgen/targets")
    rules = ("-k", "follow_the_arrows or text_and_holes or loads_no_target", "-n0", "-p", "no:cacheprovider")
    run(added, "pytest", "tests/test_architecture.py", *rules, "-o", "addopts=")


@pytest.mark.slow
def test_its_key_changes_the_golden_file_that_the_page_names(added: Path) -> None:
    golden = shutil.copytree(REPOSITORY / "tests" / "errors", added / "tests" / "errors")
    before = {path: path.read_text() for path in golden.rglob("expected.txt")}
    quick = ("-n0", "-p", "no:cacheprovider", "-o", "addopts=", "--update-golden")
    run(added, "pytest", "tests/cli/test_errors.py", "-k", "SHM203 or SHM5", *quick)
    changed = [path.relative_to(added).as_posix() for path, text in before.items() if path.read_text() != text]
    assert changed == re.findall(r"`(tests/errors/\S+/expected.txt)`", PAGE.read_text())


def test_its_offsets_are_those_of_the_layouts(added: Path, tmp_path: Path) -> None:
    """Whether or not there is a compiler to read them."""
    run(added, "shmgen", "generate", "-q", "-t", "rust", *TYPES, inside=tmp_path)
    layouts = pipeline.lay_out(Config(tmp_path), TYPES)
    for name, layout in layouts.items():
        (text,) = [
            file.read_text()
            for file in tmp_path.rglob(f"{name.package}/**/*.rs")
            if f"pub struct {name.name} " in file.read_text()
        ]
        asserted = re.findall(r"offset_of!\(\w+, (\w+)\) == (\d+)\)", text)
        assert [int(offset) for _, offset in asserted] == [slot.offset for slot in layout.slots]
        assert re.findall(r"size_of::<\w+>\(\) == (\d+)", text) == [str(layout.size)]
        assert re.findall(r"^    pub (\w+): ", text, re.MULTILINE) == [name for name, _ in asserted]
