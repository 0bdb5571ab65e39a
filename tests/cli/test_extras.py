"""Check that a command names its missing extra and the pip command, and that other commands need no extras."""

from __future__ import annotations

import re
import subprocess
import sys
from pathlib import Path

import pytest

from tests.conftest import REPOSITORY
from tests.test_distributions import tomllib

EXTRAS = tomllib.loads((REPOSITORY / "pyproject.toml").read_text())["project"]["optional-dependencies"]
MODULES = {"eclipse_zenoh": "zenoh"}
TOPIC = '[[topics]]\ntopic = "/cell/goal"\ntype = "geometry_msgs/Point"\n'


def run_without(extras: tuple[str, ...], words: list[str], folder: Path) -> subprocess.CompletedProcess[str]:
    """Run shmgen in a Python in which the packages of these extras cannot be imported."""
    names = [re.split(r"[^\w-]", requirement)[0].replace("-", "_") for extra in extras for requirement in EXTRAS[extra]]
    code = f"import sys; sys.modules.update(dict.fromkeys({[MODULES.get(name, name) for name in names]}))\n"
    code += "from shmgen.cli.main import main; main()"
    (folder / "shmgen.toml").write_text(TOPIC)
    return subprocess.run(
        [sys.executable, "-c", code, *words], cwd=folder, capture_output=True, text=True, timeout=60, check=False
    )


@pytest.mark.parametrize(
    ("extra", "words", "line"),
    [
        ("view", ["view", "--terminal"], "`pip install '.[view]'`"),
        ("dds", ["bridge", "--backend", "dds"], "`pip install cyclonedds`"),
        ("zenoh", ["bridge", "--backend", "zenoh"], "`pip install eclipse-zenoh xxhash`"),
    ],
)
def test_missing_extra_is_named(extra: str, words: list[str], line: str, tmp_path: Path) -> None:
    result = run_without((extra,), words, tmp_path)
    assert result.returncode == 1
    assert line in result.stderr
    assert "Traceback" not in result.stderr


@pytest.mark.slow
def test_bags_require_no_extra(tmp_path: Path, topic: str) -> None:
    """Use bags without extras: their dependencies are also dependencies of the definitions."""
    extras = ("view", "dds", "zenoh")
    assert run_without(extras, ["pub", "--once", topic, "std_msgs/Bool", "data: true"], tmp_path).returncode == 0
    assert run_without(extras, ["record", topic, "-d", "0.3", "-o", "bag"], tmp_path).returncode == 0
    result = run_without(extras, ["play", "bag"], tmp_path)
    assert "pip install" not in result.stderr
    assert "Traceback" not in result.stderr
