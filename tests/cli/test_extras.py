"""A command that needs an extra says which one and what to type where it is missing; no other command needs one."""

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


def without(extras: tuple[str, ...], words: list[str], folder: Path) -> subprocess.CompletedProcess[str]:
    """Of a Python in which the packages of these extras are not."""
    names = [re.split(r"[^\w-]", need)[0].replace("-", "_") for extra in extras for need in EXTRAS[extra]]
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
def test_it_names_itself(extra: str, words: list[str], line: str, tmp_path: Path) -> None:
    done = without((extra,), words, tmp_path)
    assert done.returncode == 1
    assert line in done.stderr
    assert "Traceback" not in done.stderr


@pytest.mark.slow
def test_bags_need_none(tmp_path: Path, topic: str) -> None:
    """Nothing would be saved: what they read and write with, the definitions need too."""
    extras = ("view", "dds", "zenoh")
    assert without(extras, ["pub", "--once", topic, "std_msgs/Bool", "data: true"], tmp_path).returncode == 0
    assert without(extras, ["record", topic, "-d", "0.3", "-o", "bag"], tmp_path).returncode == 0
    done = without(extras, ["play", "bag"], tmp_path)
    assert "pip install" not in done.stderr
    assert "Traceback" not in done.stderr
