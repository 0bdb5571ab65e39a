"""All installed Pythons generate the same bytes, also in another folder, locale and time zone."""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
from functools import cache
from pathlib import Path

import pytest

from .conftest import REPOSITORY
from .drift.test_check import write
from .support.command import tree

ROBOT = """# Everything that has a text of its own. °µ
float64 PI=3.14159
string NAME="über"
float32[3] start [0.1, 2, 1e-7]
builtin_interfaces/Time stamp
wstring<=8 wide
geometry_msgs/PoseStamped[<=3] poses
"""
PLACES = {
    "here": {},
    "there": {"LC_ALL": "C", "TZ": "Pacific/Chatham", "PYTHONHASHSEED": "1", "PYTHONUTF8": "0"},
}


@cache
def interpreter(version: str) -> str:
    """Return a Python of a version in PATH or from pyenv, or `""`. Run it, because a shim of pyenv may fail."""
    pyenv = sorted(Path(os.environ.get("PYENV_ROOT", Path.home() / ".pyenv")).glob(f"versions/{version}.*/bin/python"))
    for python in (shutil.which(f"python{version}"), *pyenv):
        command = [str(python), "-c", "import sys; print('%d.%d' % sys.version_info[:2])"]
        if python and subprocess.run(command, capture_output=True, text=True, check=False).stdout.strip() == version:
            return str(python)
    return ""


@pytest.fixture(scope="module")
def packages_folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The installed packages that generating needs, without their compiled parts, which fit only this Python.

    rosbags needs numpy, but only this Python loads it: the others read its definitions from the cache.
    """
    folder = tmp_path_factory.mktemp("packages")
    import click
    import jinja2
    import markupsafe
    import rosbags

    for package in (click, jinja2, markupsafe, rosbags):
        source = Path(next(iter(package.__path__)))
        shutil.copytree(source, folder / source.name, ignore=shutil.ignore_patterns("*.so", "__pycache__"))
    # Python 3.10 has no tomllib, but pip contains tomli.
    (folder / "tomli.py").write_text("from pip._vendor.tomli import TOMLDecodeError, loads\n")
    return folder


def generate(python: str, folder: Path, packages: Path, environment: dict[str, str]) -> dict[str, bytes | None]:
    write(folder, {"msgs/demo_msgs/msg/Robot.msg": ROBOT})
    write(folder, {"shmgen.toml": 'messages = ["demo_msgs/Robot"]\npath = ["msgs"]\n[[topics]]\ntopic = "/r"\n'})
    with (folder / "shmgen.toml").open("a") as settings:
        settings.write('type = "demo_msgs/Robot"\n')
    environment = {
        **os.environ,
        "PYTHONPATH": f"{REPOSITORY / 'src'}:{packages}",
        "PYTHONDONTWRITEBYTECODE": "1",
        "XDG_CACHE_HOME": str(packages / "cache"),
        **environment,
    }
    command = [python, "-m", "shmgen", "generate", "--quiet"]
    done = subprocess.run(command, cwd=folder, env=environment, capture_output=True, text=True, check=False)
    assert (done.returncode, done.stderr) == (0, "")
    return tree(folder / "generated")


@pytest.mark.sample("[3.10-here]")
@pytest.mark.parametrize("place", PLACES)
@pytest.mark.parametrize("version", ["3.10", "3.11", "3.12", "3.13"])
def test_all_pythons_generate_the_same_bytes(version: str, place: str, packages_folder: Path, tmp_path: Path) -> None:
    python = interpreter(version)
    if not python:
        pytest.skip(f"no Python {version} here")
    ours = generate(sys.executable, tmp_path / "ours", packages_folder, {})
    assert len(ours) > 40
    assert generate(python, tmp_path / "a" / place, packages_folder, PLACES[place]) == ours
    outputs = [print_message(each, tmp_path / "ours", packages_folder) for each in (sys.executable, python)]
    assert outputs[0] == outputs[1]


def print_message(python: str, folder: Path, packages: Path) -> str:
    """Return the output of a program with a generated class. A stub replaces posix_ipc, because no region is opened."""
    code = """
import sys, types
sys.modules["posix_ipc"] = types.SimpleNamespace(Semaphore=None, Error=OSError, ExistentialError=OSError)
from shm_msgs.demo_msgs.msg import Robot
made = Robot(wide="\u00fc")
print(made, bytes(made).hex())
try:
    made.start[1] = "x"
except Exception as error:
    print(error)
"""
    paths = f"{folder / 'generated' / 'python'}:{REPOSITORY / 'src'}:{packages}"
    environment = {**os.environ, "PYTHONPATH": paths, "PYTHONDONTWRITEBYTECODE": "1", "SHMGEN_PURE": "1"}
    command = [python, "-X", "utf8", "-c", code]
    done = subprocess.run(command, env=environment, capture_output=True, text=True, check=False)
    assert (done.returncode, done.stderr) == (0, "")
    return done.stdout
