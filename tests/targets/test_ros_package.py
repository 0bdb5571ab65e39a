"""Test the ROS packages of targets ros1 and ros2 with catkin_pkg, roslaunch and setuptools."""

from __future__ import annotations

import ast
import json
import os
import subprocess
import sys
from pathlib import Path

import pytest

from shmgen.targets.ros.package import default_name

from ..conftest import REPOSITORY
from ..definitions.test_idl import needs_rosidl
from ..support import import_or_skip
from ..support.build import put
from ..support.command import run

SYSTEM_PYTHON = "/usr/bin/python3"
"""Debian's Python, which has the ROS tools of Debian's packages."""
PROJECT = {
    "shmgen.toml": """# What the cell talks about.
ros_package = "cell_bridge"
distribution = "cell-shm 1.2.3"
path = [
    "msgs",
]

[[topics]]
topic = "/cell/state"
type = "cell_msgs/State"

[[topics]]
topic = "/robot/pose"
type = "geometry_msgs/Pose"

[[services]]
service = "/cell/start"
type = "cell_msgs/Start"
server = "plc"
""",
    "msgs/cell_msgs/msg/State.msg": "float64 speed  # [m/s]\nPart[2] parts\nstd_msgs/Header header\n",
    "msgs/cell_msgs/msg/Part.msg": "string<=8 name\n",
    "msgs/cell_msgs/srv/Start.srv": "bool go\n---\nbool ok\n",
}

_USES = {"topic": ("Level",), "service": ("Twin", "Empty", "Ask", "Tell"), "action": ("Move",)}
RICH = {
    "pyproject.toml": """[project]
name = "cell"
version = "1"

[tool.shmgen]
ros_package = "cell_bridge"
path = ["msgs [old]"]
messages = ["msgs [old]/cell_msgs/msg/Named.msg"]
[tool.shmgen.bounds]
"cell_msgs/Named.names" = 0x3
[tool.shmgen.strings]
"cell_msgs/Named.names" = 16
"""
    + "".join(
        f'[[tool.shmgen.{use}s]]\n{use} = "/cell/{name}"\ntype = "cell_msgs/{name}"\n'
        for use, names in _USES.items()
        for name in names
    )
    + 'server = "ros"\n',
    "msgs [old]/cell_msgs/msg/Named.msg": "string[] names\n",
    "msgs [old]/cell_msgs/msg/Level.msg": "Named named\nfloat64 value\n",
    "msgs [old]/cell_msgs/srv/Twin.srv": "bool ok\n---\nbool ok\n",
    "msgs [old]/cell_msgs/srv/Empty.srv": "---\n",
    "msgs [old]/cell_msgs/srv/Ask.srv": "# nothing\n\n---\nbool ok\n",
    "msgs [old]/cell_msgs/srv/Tell.srv": "bool go\n---\n",
    "msgs [old]/cell_msgs/action/Move.action": "---\nint8 a\n---\nint8 a\n",
}
"""Settings in pyproject.toml, a folder that looks like TOML, a message given by its file, empty and equal parts."""
IDL = {
    "msgs [old]/cell_msgs/msg/Level.idl": """module cell_msgs { module msg {
  struct Level { cell_msgs::msg::Named named; @unit (value="m") double value; };
}; };
""",
    "msgs [old]/cell_msgs/srv/Twin.idl": """module cell_msgs { module srv {
  struct Twin_Request { boolean ok; };
  struct Twin_Response { boolean ok; };
}; };
""",
}
"""Equivalent .idl files that replace two of these files."""


@pytest.fixture
def project(tmp_path: Path) -> Path:
    put(PROJECT, tmp_path)
    result = run(["generate", "-q", "-t", "ros1", "-t", "ros2"], tmp_path)
    assert result.code == 0, result.stderr
    return tmp_path


def debian_output(module: str, code: str, *arguments: str, **environment: str) -> str:
    """Return the output of Debian's Python, or skip the test if the module is missing."""
    command = [SYSTEM_PYTHON, "-c", f"import {module}\n{code}", *arguments]
    if not Path(SYSTEM_PYTHON).exists() or subprocess.run([*command[:2], f"import {module}"], check=False).returncode:
        pytest.skip(f"{SYSTEM_PYTHON} has no {module}")
    environ = {name: value for name, value in os.environ.items() if name not in ("PYTHONPATH", "PYTHONHOME")}
    done = subprocess.run(command, env={**environ, **environment}, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    return done.stdout


@pytest.mark.parametrize(("ros", "kind", "code"), [("ros1", "catkin", "rospy"), ("ros2", "ament_python", "rclpy")])
def test_catkin_pkg_accepts_the_manifest(ros: str, kind: str, code: str, project: Path) -> None:
    text = debian_output(
        "catkin_pkg.package, sys",
        "warnings = []\n"
        "package = catkin_pkg.package.parse_package(sys.argv[1], warnings=warnings)\n"
        "package.validate(warnings=warnings)\n"
        "print(package.name, package.version, package.get_build_type(), *warnings)\n"
        "print(*[depend.name for depend in package.exec_depends])",
        str(project / "generated" / ros / "cell_bridge"),
    )
    first, depends = text.splitlines()
    assert first == f"cell_bridge 1.2.3 {kind}"
    assert {code, "cell_msgs", "geometry_msgs"} <= set(depends.split())


@pytest.mark.slow
def test_roslaunch_loads_the_launch_file(project: Path) -> None:
    folder = project / "generated" / "ros1" / "cell_bridge"
    text = debian_output(
        "roslaunch.config, sys",
        "loaded = roslaunch.config.load_config_default([sys.argv[1]], None)\n"
        "for node in loaded.nodes: print(node.package, node.type, node.name, node.args)",
        str(folder / "launch" / "bridge.launch"),
        ROS_PACKAGE_PATH=str(folder.parent),
        ROS_HOME=str(project / "ros_home"),
    )
    assert text.splitlines()[-1] == (f"cell_bridge bridge shmgen_bridge -c {folder}/config/shmgen.toml --backend ros1")


def test_ros2_launch_file_starts_the_installed_executable(project: Path) -> None:
    folder = project / "generated" / "ros2" / "cell_bridge"
    tree = ast.parse((folder / "launch" / "bridge.launch.py").read_text())
    (node,) = [it for it in ast.walk(tree) if isinstance(it, ast.Call) and getattr(it.func, "id", "") == "Node"]
    arguments = {it.arg: it.value.value for it in node.keywords if isinstance(it.value, ast.Constant)}
    expected = {"package": "cell_bridge", "executable": "bridge", "name": "shmgen_bridge", "output": "screen"}
    assert arguments == {**expected, "respawn": True, "respawn_delay": 1.0}
    assert '"bridge = " + NAME + ":main"' in (folder / "setup.py").read_text()
    assert (folder / "config" / "bridge.yaml").read_text().splitlines()[1] == "shmgen_bridge:"


@pytest.mark.slow
def test_installed_package_starts_the_bridge(project: Path) -> None:
    import_or_skip("setuptools")
    folder, target = project / "generated" / "ros2" / "cell_bridge", project / "install"
    command = [sys.executable, "setup.py", "-q", "install", f"--prefix={target}", f"--record={project}/record"]
    done = subprocess.run(
        [*command, "--single-version-ext", f"--install-lib={target}/lib"],
        cwd=folder,
        capture_output=True,
        text=True,
        check=False,
    )
    assert done.returncode == 0, done.stderr
    assert {str(path.relative_to(target)) for path in (target / "share").rglob("*") if path.is_file()} == {
        "share/ament_index/resource_index/packages/cell_bridge",
        "share/cell_bridge/package.xml",
        "share/cell_bridge/launch/bridge.launch.py",
        "share/cell_bridge/config/shmgen.toml",
        "share/cell_bridge/config/bridge.yaml",
        "share/cell_bridge/config/msgs/cell_msgs/msg/State.msg",
        "share/cell_bridge/config/msgs/cell_msgs/msg/Part.msg",
        "share/cell_bridge/config/msgs/cell_msgs/srv/Start.srv",
    }
    code = "import cell_bridge; cell_bridge.main()"
    paths = os.pathsep.join([str(target / "lib"), str(REPOSITORY / "src")])
    command = [
        sys.executable,
        "-c",
        code,
        "-c",
        str(target / "share/cell_bridge/config/shmgen.toml"),
        "--backend",
        "no",
    ]
    done = subprocess.run(command, env={**os.environ, "PYTHONPATH": paths}, capture_output=True, text=True, check=False)
    assert "Usage: -c bridge" in done.stderr
    assert "Invalid value for '--backend'" in done.stderr


@pytest.mark.parametrize("ros", ["ros1", "ros2"])
def test_configuration_in_the_package_gives_equal_layouts(ros: str, project: Path, tmp_path: Path) -> None:
    config = project / "generated" / ros / "cell_bridge" / "config" / "shmgen.toml"
    for message in ("cell_msgs/State", "geometry_msgs/Pose", "cell_msgs/Start_Reply"):
        local, packaged = run(["show", message], project), run(["show", message, "-c", str(config)], tmp_path)
        assert (local.code, packaged.code) == (0, 0), local.stderr + packaged.stderr
        assert local.stdout.splitlines()[0] == packaged.stdout.splitlines()[0]


@pytest.mark.parametrize("idl", [False, pytest.param(True, marks=needs_rosidl)], ids=["msg", "idl"])
def test_package_contains_all_of_a_complex_project(idl: bool, tmp_path: Path) -> None:
    files = {path: text for path, text in RICH.items() if not idl or str(Path(path).with_suffix(".idl")) not in IDL}
    put({**files, **(IDL if idl else {})}, tmp_path)
    result = run(["generate", "-q", "-t", "ros1", "-t", "ros2"], tmp_path)
    assert result.code == 0, result.stderr
    for ros in ("ros1", "ros2"):
        config = tmp_path / "generated" / ros / "cell_bridge" / "config"
        copies = {path.name for path in (config / "msgs").rglob("*.*")}
        assert copies == {Path(path).name for path in (*files, *(IDL if idl else ())) if path.startswith("msgs")}
        for name in (
            "Level",
            "Twin_Request",
            "Twin_Response",
            "Empty_Reply",
            "Ask_Reply",
            "Tell_Request",
            "Move_Outcome",
        ):
            words = ["show", "--json", f"cell_msgs/{name}"]
            local, packaged = run(words, tmp_path), run([*words, "-c", str(config / "shmgen.toml")], tmp_path)
            assert packaged.code == 0, packaged.stderr
            expected, entries = (json.loads(it.stdout) for it in (local, packaged))
            assert [{**entry, "origin": ""} for entry in expected] == [{**entry, "origin": ""} for entry in entries]


def test_ros_packages_are_written_only_on_request(project: Path) -> None:
    assert run(["check", "-t", "ros1", "-t", "ros2"], project).code == 0
    assert run(["generate", "-q"], project).code == 0
    assert not (project / "generated" / "ros2" / "cell_bridge" / "package.xml").exists()


def test_default_name_derives_from_the_python_package() -> None:
    assert default_name("shm_msgs") == "shm_msgs_bridge"
    assert default_name("Shm__Cell_") == "shm_cell_bridge"
