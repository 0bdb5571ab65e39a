"""Test `shmgen init`: the packages that it finds, the files that it writes, and that it keeps existing files."""

from __future__ import annotations

import json
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest

from shmgen import __version__
from shmgen.cli import init

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


def run_init(folder: Path, *options: str) -> str:
    result = run(["init", *options], folder)
    assert (result.code, result.stderr) == (0, ""), result.stderr
    return result.stdout


def test_init_lists_packages_and_unbounded_sequences(tmp_path: Path) -> None:
    write(tmp_path, PACKAGES)
    assert run_init(tmp_path).splitlines() == [
        "shmgen.toml written",
        "found demo_msgs, robot_msgs; 3 sequences hold at most 32 elements (see [bounds] in shmgen.toml)",
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


def test_init_works_in_a_package(tmp_path: Path) -> None:
    folder = tmp_path / "demo_msgs"
    write(folder, {"package.xml": "<package><name>demo_msgs</name></package>", "msg/Arm.msg": "int8 a\n"})
    assert "found demo_msgs\n" in run_init(folder)
    assert run(["generate"], folder).code == 0


def test_init_reads_a_catkin_package_as_ros1(tmp_path: Path) -> None:
    manifest = "<package><name>old_msgs</name><buildtool_depend>catkin</buildtool_depend></package>"
    write(tmp_path, {"old_msgs/package.xml": manifest, "old_msgs/msg/Arm.msg": "Header header\nint8 aB\n"})
    run_init(tmp_path)
    assert run(["generate"], tmp_path).code == 0


def test_init_in_an_empty_folder(tmp_path: Path) -> None:
    output = run_init(tmp_path)
    assert "this folder has no message package" in output
    assert output.endswith("next:\n  shmgen list\n  shmgen generate\n")
    assert "error[SHM504]" in run(["generate"], tmp_path).stderr


@pytest.mark.parametrize("path", ["shmgen.toml", "pyproject.toml"])
def test_init_keeps_an_existing_configuration(tmp_path: Path, path: str) -> None:
    write(tmp_path, {**PACKAGES, path: "[tool.shmgen]\n", init.HOOK_FILE: "repos: []\n", init.CI_FILE: "name: CI\n"})
    before = tree(tmp_path)
    output = run_init(tmp_path, "--hook", "--ci", "--from", SOURCE)
    assert f"{path} already has a configuration and was not changed" in output
    assert init.HOOK in output
    assert init.CI.format(requirement=SOURCE) in output
    assert tree(tmp_path) == before


def test_init_adds_hook_and_ci(tmp_path: Path) -> None:
    write(tmp_path, PACKAGES)
    assert "  pre-commit install " in run_init(tmp_path, "--hook", "--ci", "--from", SOURCE)  # installs the hook
    assert "pre-commit" not in run_init(tmp_path)
    assert (tmp_path / init.HOOK_FILE).read_text() == init.HOOK
    assert (tmp_path / init.CI_FILE).read_text() == init.CI.format(requirement=SOURCE)


@pytest.mark.parametrize(
    ("direct_url", "requirement"),
    [
        (None, f"shmgen[idl]=={__version__}"),
        ({"url": "https://h.org/shmgen", "vcs_info": {"vcs": "git", "commit_id": "ab12"}}, "shmgen[idl] @ git+https://h.org/shmgen@ab12"),
        ({"url": "https://h.org/shmgen-1.whl", "archive_info": {}}, "shmgen[idl] @ https://h.org/shmgen-1.whl"),
        ({"url": "file:///home/me/shmgen", "dir_info": {}}, None),
        ({"url": "file:///tmp/shmgen-1.whl", "archive_info": {}}, None),
    ],
)  # fmt: skip
def test_ci_installs_the_installed_version(
    monkeypatch: pytest.MonkeyPatch, direct_url: dict[str, Any] | None, requirement: str | None
) -> None:
    text = direct_url and json.dumps(direct_url)
    monkeypatch.setattr(init, "distribution", lambda _: SimpleNamespace(read_text=lambda _: text))
    assert init.requirement() == requirement


def test_ci_cannot_install_a_local_folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(init, "requirement", lambda: None)
    result = run(["init", "--ci"], tmp_path)
    assert result.code == 2
    assert "such as 'shmgen[idl] @ git+https://" in result.stderr
    assert not tree(tmp_path)


def test_invalid_definition_prevents_init(tmp_path: Path) -> None:
    write(tmp_path, {"demo_msgs/msg/Arm.msg": "int8\n"})
    before = tree(tmp_path)
    result = run(["init", "--hook"], tmp_path)
    assert (result.code, tree(tmp_path)) == (1, before)
    assert "error[SHM003]" in result.stderr


def test_hooks_check_the_same_files() -> None:
    hooks = (REPOSITORY / ".pre-commit-hooks.yaml").read_text()
    assert hooks.count(f"  files: {init.FILES}\n") == 2
    assert f"        files: {init.FILES}\n" in init.HOOK
