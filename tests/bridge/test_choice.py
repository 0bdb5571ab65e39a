"""Test which backend the bridge selects and why, and the hint if a backend is missing."""

from __future__ import annotations

import importlib.util
import re
import subprocess
import sys
from pathlib import Path

import pytest

from shmgen.bridge.backend import BackendMissing
from shmgen.bridge.common import choice

from ..conftest import REPOSITORY
from ..support import ros2


@pytest.fixture
def installed(monkeypatch: pytest.MonkeyPatch) -> set[str]:
    """The names of the modules that backends can import."""
    names: set[str] = set()
    monkeypatch.delenv("ROS_VERSION", raising=False)
    monkeypatch.setattr(importlib.util, "find_spec", lambda name: name if name in names else None)
    return names


@pytest.mark.parametrize(
    ("version", "names", "chosen"),
    [
        (None, {"rospy"}, ("ros1", "rospy is installed")),
        (None, {"rospy", "rclpy", "cyclonedds"}, ("ros2", "rclpy is installed")),
        (None, {"rospy", "cyclonedds", "zenoh"}, ("dds", "cyclonedds is installed")),
        (None, {"rospy", "zenoh"}, ("zenoh", "zenoh is installed")),
        ("1", {"rospy", "rclpy"}, ("ros1", "ROS_VERSION is 1")),
        ("2", set(), ("ros2", "ROS_VERSION is 2")),
    ],
)
def test_auto_selects_an_installed_backend(
    installed: set[str], monkeypatch: pytest.MonkeyPatch, version: str | None, names: set[str], chosen: tuple[str, str]
) -> None:
    installed |= names
    if version:
        monkeypatch.setenv("ROS_VERSION", version)
    assert choice.chosen("auto") == chosen


def test_configured_backend_is_used(installed: set[str]) -> None:
    assert choice.chosen("dds") == ("dds", "as configured")


@pytest.mark.parametrize("backend", ["ros2", "dds", "zenoh", "ros1"])
def test_missing_backend_error_has_an_install_hint(installed: set[str], backend: str) -> None:
    with pytest.raises(BackendMissing, match=f"backend {backend}: .* is missing\n  hint: .*(apt-get|source|pip) "):
        choice.module(backend)


def test_error_lists_all_backends_if_none_is_installed(installed: set[str]) -> None:
    with pytest.raises(BackendMissing, match=r"no backend is installed\n  ros2: .*\n  dds: .*\n  zenoh: .*\n  ros1: "):
        choice.chosen("auto")


def test_command_reports_a_missing_backend(tmp_path: Path) -> None:
    """Report a missing rclpy, but if the configuration is empty, report only this."""
    (tmp_path / "shmgen.toml").write_text('[[topics]]\ntopic = "/a"\ntype = "std_msgs/Bool"\n')
    hide = "import sys; sys.modules['rclpy'] = None; from shmgen.__main__ import main; main()"
    command = [sys.executable, "-c", hide, "bridge", "--backend", "ros2"]
    environment = {"PYTHONPATH": str(REPOSITORY / "src"), "PATH": ""}
    result = subprocess.run(command, cwd=tmp_path, env=environment, capture_output=True, text=True, check=False)
    assert (result.returncode, result.stdout) == (1, "")
    assert result.stderr.startswith(
        "shmgen.toml: error[SHM706]: backend ros2: rclpy is missing\n  hint: `source /opt/ros/jazzy/setup.bash`"
    )
    (tmp_path / "shmgen.toml").write_text("")
    result = subprocess.run(command, cwd=tmp_path, env=environment, capture_output=True, text=True, check=False)
    assert result.returncode == 1
    assert result.stderr.startswith("shmgen.toml: error[SHM504]: no topic, service or action is listed\n  hint: add ")


OTHER_PYTHON = "`source /opt/ros/jazzy/setup.bash`, in the Python that ROS was built for"


@pytest.mark.parametrize(
    ("rclpy", "message"),
    [
        ("import yaml", "rclpy needs yaml, which is missing here\n  hint: `{python} -m pip install pyyaml`"),
        ("import rclpy._rclpy_pybind11", f"rclpy cannot be loaded, No module named .*\n  hint: {OTHER_PYTHON}"),
        (
            "raise ImportError('libx.so: cannot open')",
            f"rclpy cannot be loaded, libx.so: cannot open\n  hint: {OTHER_PYTHON}",
        ),
        ("", "rclpy needs yaml, which is missing here\n  hint: `{python} -m pip install pyyaml`"),
    ],
    ids=["no PyYAML", "another Python", "not sourced", "no PyYAML, with the real one"],
)
def test_unusable_rclpy_error_has_a_hint(tmp_path: Path, rclpy: str, message: str) -> None:
    """Report also a missing PyYAML: on Ubuntu it is a system package, invisible to pipx and virtual environments."""
    (tmp_path / "shmgen.toml").write_text('[[topics]]\ntopic = "/a"\ntype = "std_msgs/Bool"\n')
    python = Path(sys.executable) if rclpy else ros2.prefix("jazzy") / "bin" / "python"
    if rclpy:
        (tmp_path / "rclpy").mkdir()
        (tmp_path / "rclpy" / "__init__.py").write_text(rclpy)
    hide = "import sys; sys.modules['yaml'] = None; from shmgen.__main__ import main; main()"
    command = [python, "-c", hide, "bridge", "--backend", "ros2"]
    environment = {"PYTHONPATH": f"{REPOSITORY / 'src'}:{tmp_path}", "PATH": ""}
    result = subprocess.run(command, cwd=tmp_path, env=environment, capture_output=True, text=True, check=False)
    assert (result.returncode, result.stdout) == (1, "")
    line = re.escape("shmgen.toml: error[SHM706]: backend ros2: ") + message.format(python=re.escape(str(python)))
    assert re.fullmatch(f"{line}\n", result.stderr), result.stderr
