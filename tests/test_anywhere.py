"""The same input gives the same bytes under every Python that is found here, in another folder, language and time."""

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
    """A Python of that version: in PATH, or one that pyenv keeps. It must run, as a shim of pyenv may not."""
    kept = sorted(Path(os.environ.get("PYENV_ROOT", Path.home() / ".pyenv")).glob(f"versions/{version}.*/bin/python"))
    for found in (shutil.which(f"python{version}"), *kept):
        command = [str(found), "-c", "import sys; print('%d.%d' % sys.version_info[:2])"]
        if found and subprocess.run(command, capture_output=True, text=True, check=False).stdout.strip() == version:
            return str(found)
    return ""


@pytest.fixture(scope="module")
def pure(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """What generating needs, of the packages installed here; the compiled parts of them are for this Python only.

    rosbags wants numpy, but only this Python loads it: the others find its definitions in the cache.
    """
    folder = tmp_path_factory.mktemp("packages")
    import click
    import jinja2
    import markupsafe
    import rosbags

    for package in (click, jinja2, markupsafe, rosbags):
        source = Path(next(iter(package.__path__)))
        shutil.copytree(source, folder / source.name, ignore=shutil.ignore_patterns("*.so", "__pycache__"))
    # Python 3.10 has none of its own, but pip has.
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


@pytest.mark.slow
@pytest.mark.parametrize("place", PLACES)
@pytest.mark.parametrize("version", ["3.10", "3.11", "3.12", "3.13"])
def test_the_same_bytes(version: str, place: str, pure: Path, tmp_path: Path) -> None:
    python = interpreter(version)
    if not python:
        pytest.skip(f"no Python {version} here")
    ours = generate(sys.executable, tmp_path / "ours", pure, {})
    assert len(ours) > 40
    assert generate(python, tmp_path / "a" / place, pure, PLACES[place]) == ours
    shown = [message_of(which, tmp_path / "ours", pure) for which in (sys.executable, python)]
    assert shown[0] == shown[1]


def message_of(python: str, folder: Path, packages: Path) -> str:
    """What a generated class holds and takes there. posix_ipc is compiled for one Python, and no region is opened."""
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
