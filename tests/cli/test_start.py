"""`shmgen init`: what it finds in a folder, what it writes, and that it touches nothing that exists."""

from __future__ import annotations

import json
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest

from shmgen import __version__
from shmgen.cli import init, install_source

from ..conftest import REPOSITORY
from ..drift.test_check import write
from ..support.command import run, tree

SOURCE = "git+https://git.example.org/shmgen@v1"
ROBOT = "float64[] speeds\nArm[] arms\n"
PACKAGES = {
    "src/demo_msgs/msg/Robot.msg": ROBOT,
    "src/demo_msgs/msg/Arm.msg": "string name\nfloat64[] joints\n",
    "src/more/robot_msgs/package.xml": "<package><name>robot_msgs</name></package>",
    "src/more/robot_msgs/srv/Stop.srv": "---\nbool done\n",
    "src/tools/package.xml": "<package><name>tools</name></package>",
}


def begun(folder: Path, *options: str) -> str:
    result = run(["init", *options], folder)
    assert (result.code, result.stderr) == (0, ""), result.stderr
    return result.stdout


def test_it_lists_packages_and_what_must_be_bounded(tmp_path: Path) -> None:
    write(tmp_path, PACKAGES)
    assert begun(tmp_path).splitlines() == [
        "shmgen.toml written",
        "found demo_msgs, robot_msgs; 3 sequences hold at most 32, unless [bounds] says otherwise",
        "",
        "next:",
        "  shmgen generate",
        "  shmgen check",
    ]
    text = (tmp_path / "shmgen.toml").read_text()
    assert 'messages = ["demo_msgs", "robot_msgs"]\npath = ["src"]\nsource = "jazzy"\n' in text
    bounds = [line for line in text.splitlines() if line.startswith('# "')]
    assert bounds == [f'# "demo_msgs/{key}" =' for key in ("Arm.joints", "Robot.speeds", "Robot.arms")]
    assert "\n[bounds]\ndefault = 32 " in text
    assert run(["generate"], tmp_path).code == 0
    for line in bounds:
        text = text.replace(line, f"{line[2:]} 4")
    write(tmp_path, {"shmgen.toml": text})
    assert run(["generate"], tmp_path).code == 0
    assert run(["check"], tmp_path).code == 0


def test_a_package_is_a_place_to_start_too(tmp_path: Path) -> None:
    folder = tmp_path / "demo_msgs"
    write(folder, {"package.xml": "<package><name>demo_msgs</name></package>", "msg/Arm.msg": "int8 a\n"})
    assert "found demo_msgs\n" in begun(folder)
    assert run(["generate"], folder).code == 0


def test_a_catkin_package_is_read_as_ros_1(tmp_path: Path) -> None:
    manifest = "<package><name>old_msgs</name><buildtool_depend>catkin</buildtool_depend></package>"
    write(tmp_path, {"old_msgs/package.xml": manifest, "old_msgs/msg/Arm.msg": "Header header\nint8 aB\n"})
    begun(tmp_path)
    assert run(["generate"], tmp_path).code == 0


def test_an_empty_folder(tmp_path: Path) -> None:
    said = begun(tmp_path)
    assert "no message package is in this folder" in said
    assert said.endswith("next:\n  shmgen list\n  shmgen generate\n")
    assert "error[SHM504]" in run(["generate"], tmp_path).stderr


@pytest.mark.parametrize("path", ["shmgen.toml", "pyproject.toml"])
def test_a_configuration_stays_as_it_is(tmp_path: Path, path: str) -> None:
    write(tmp_path, {**PACKAGES, path: "[tool.shmgen]\n", init.HOOK_FILE: "repos: []\n", init.CI_FILE: "name: CI\n"})
    before = tree(tmp_path)
    said = begun(tmp_path, "--hook", "--ci", "--from", SOURCE)
    assert f"{path} has a configuration, and is left as it is" in said
    assert init.HOOK in said
    assert init.CI.format(requirement=SOURCE) in said
    assert tree(tmp_path) == before


def test_hook_and_ci_are_added(tmp_path: Path) -> None:
    write(tmp_path, PACKAGES)
    assert "  pre-commit install " in begun(tmp_path, "--hook", "--ci", "--from", SOURCE)  # else no commit is stopped
    assert "pre-commit" not in begun(tmp_path)
    assert (tmp_path / init.HOOK_FILE).read_text() == init.HOOK
    assert (tmp_path / init.CI_FILE).read_text() == init.CI.format(requirement=SOURCE)


@pytest.mark.parametrize(
    ("noted", "requirement"),
    [
        (None, f"shmgen[idl]=={__version__}"),
        ({"url": "https://h.org/shmgen", "vcs_info": {"vcs": "git", "commit_id": "ab12"}}, "shmgen[idl] @ git+https://h.org/shmgen@ab12"),
        ({"url": "https://h.org/shmgen-1.whl", "archive_info": {}}, "shmgen[idl] @ https://h.org/shmgen-1.whl"),
        ({"url": "file:///home/me/shmgen", "dir_info": {}}, None),
        ({"url": "file:///tmp/shmgen-1.whl", "archive_info": {}}, None),
    ],
)  # fmt: skip
def test_a_ci_installs_what_was_installed_here(
    monkeypatch: pytest.MonkeyPatch, noted: dict[str, Any] | None, requirement: str | None
) -> None:
    text = noted and json.dumps(noted)
    monkeypatch.setattr(install_source, "distribution", lambda _: SimpleNamespace(read_text=lambda _: text))
    assert install_source.requirement() == requirement


def test_a_folder_of_this_machine_is_nothing_for_a_ci(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(install_source, "requirement", lambda: None)
    result = run(["init", "--ci"], tmp_path)
    assert result.code == 2
    assert "--from 'shmgen[idl] @ git+https://" in result.stderr
    assert not tree(tmp_path)


def test_a_wrong_definition_is_told_and_nothing_written(tmp_path: Path) -> None:
    write(tmp_path, {"demo_msgs/msg/Arm.msg": "int8\n"})
    before = tree(tmp_path)
    result = run(["init", "--hook"], tmp_path)
    assert (result.code, tree(tmp_path)) == (1, before)
    assert "error[SHM003]" in result.stderr


def test_our_hooks_look_at_the_same_files() -> None:
    hooks = (REPOSITORY / ".pre-commit-hooks.yaml").read_text()
    assert hooks.count(f"  files: {init.FILES}\n") == 2
    assert f"        files: {init.FILES}\n" in init.HOOK
