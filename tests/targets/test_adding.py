"""Follow docs/adding-a-target.md: the added target passes the contract, and its offsets match the layouts."""

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

GUIDE = REPOSITORY / "docs" / "adding-a-target.md"
TYPES = ("geometry_msgs/PoseStamped", "sensor_msgs/Range", "std_msgs/Empty", "std_msgs/ColorRGBA")


@pytest.fixture(scope="module")
def checkout(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A copy of the repository with the target that docs/adding-a-target.md adds."""
    folder = pages.copy(tmp_path_factory.mktemp("added"))
    assert {path.suffix for path in pages.follow(GUIDE, "rust_target", folder)} == {".py", ".j2"}
    return folder


def run(folder: Path, *arguments: str, inside: Path | None = None) -> str:
    env = {**os.environ, "PYTHONPATH": f"{folder / 'src'}:{folder}"}
    command = [sys.executable, "-m", *arguments]
    result = subprocess.run(command, cwd=inside or folder, env=env, capture_output=True, text=True, check=False)
    assert result.returncode == 0, (result.stdout + result.stderr)[-4000:]
    return result.stdout


@pytest.mark.slow
def test_added_target_passes_contract(checkout: Path) -> None:
    contract = ("tests/targets/test_contract.py", "-k", "rust or follow_the_targets", "-n0", "-p", "no:cacheprovider")
    assert re.search(r"\b9 passed", run(checkout, "pytest", *contract, "-o", "addopts="))


@pytest.mark.slow
def test_added_target_passes_lint_and_architecture_rules(checkout: Path) -> None:
    run(checkout, "ruff", "check", "--no-cache", "src/shmgen/targets", "tests/support")
    run(checkout, "ruff", "format", "--check", "--no-cache", "src/shmgen/targets", "tests/support")
    run(checkout, "mypy", "--cache-dir", str(checkout / "cache"), "src/shmgen/targets")
    rules = ("-k", "follow_the_architecture or contain_no_logic or loads_no_target", "-n0", "-p", "no:cacheprovider")
    run(checkout, "pytest", "tests/test_architecture.py", *rules, "-o", "addopts=")


@pytest.mark.slow
def test_page_names_the_golden_files_that_the_key_changes(checkout: Path) -> None:
    golden = shutil.copytree(REPOSITORY / "tests" / "errors", checkout / "tests" / "errors")
    before = {path: path.read_text() for path in golden.rglob("expected.txt")}
    quick = ("-n0", "-p", "no:cacheprovider", "-o", "addopts=", "--update-golden")
    run(checkout, "pytest", "tests/cli/test_errors.py", "-k", "SHM203 or SHM5", *quick)
    changed = [path.relative_to(checkout).as_posix() for path, text in before.items() if path.read_text() != text]
    assert changed == re.findall(r"`(tests/errors/\S+/expected.txt)`", GUIDE.read_text())


def test_offsets_of_the_added_target_match_the_layouts(checkout: Path, tmp_path: Path) -> None:
    """Compare the generated assertions as text, so that no Rust compiler is necessary."""
    run(checkout, "shmgen", "generate", "-q", "-t", "rust", *TYPES, inside=tmp_path)
    layouts = pipeline.lay_out(Config(tmp_path), TYPES)
    for name, layout in layouts.items():
        (text,) = [
            file.read_text()
            for file in tmp_path.rglob(f"{name.package}/**/*.rs")
            if f"pub struct {name.name} " in file.read_text()
        ]
        checked_offsets = re.findall(r"offset_of!\(\w+, (\w+)\) == (\d+)\)", text)
        assert [int(offset) for _, offset in checked_offsets] == [slot.offset for slot in layout.slots]
        assert re.findall(r"size_of::<\w+>\(\) == (\d+)", text) == [str(layout.size)]
        assert re.findall(r"^    pub (\w+): ", text, re.MULTILINE) == [name for name, _ in checked_offsets]
