"""The pre-commit hooks with the real pre-commit, and action.yml step by step as a runner would take it."""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

from ..conftest import REPOSITORY
from ..drift.test_check import ARM, ROBOT, SETTINGS, git, write
from ..support import import_or_skip
from ..support.command import run

yaml = import_or_skip("yaml", reason="comes with pre-commit")


@pytest.fixture
def project(tmp_path: Path) -> Path:
    """A repository whose last commit is in order."""
    folder = tmp_path / "project"
    write(folder, {"shmgen.toml": SETTINGS, "msgs/demo_msgs/msg/Robot.msg": ROBOT, "msgs/demo_msgs/msg/Arm.msg": ARM})
    assert run(["generate", "-q"], folder).code == 0
    git(folder, "init", "-q")
    return folder


def commit(folder: Path, environment: dict[str, str]) -> subprocess.CompletedProcess[str]:
    git(folder, "add", ".")
    identity = ["-c", "user.name=a", "-c", "user.email=a@example.org"]
    command = ["git", *identity, "commit", "-qm", "a change"]
    return subprocess.run(command, cwd=folder, env=environment, capture_output=True, text=True, check=False)


@pytest.mark.slow
def test_pre_commit_stops_what_has_drifted(project: Path, tmp_path: Path) -> None:
    """It installs us by pip into an environment of its own, from a repository with the files of this checkout."""
    import_or_skip("pre_commit")
    tool = tmp_path / "tool"
    listed = subprocess.run(
        ["git", "ls-files", "-z", "--cached", "--others", "--exclude-standard"],
        cwd=REPOSITORY,
        capture_output=True,
        check=False,
    )
    if listed.returncode:
        pytest.skip("this is no checkout of git")
    for name in filter(None, listed.stdout.decode().split("\0")):
        needed = name.startswith(("src/", "templates/", ".pre-commit")) or name in (
            "pyproject.toml",
            "hatch_build.py",
            "README.md",
            "LICENSE",
        )
        if needed and (REPOSITORY / name).is_file():
            (tool / name).parent.mkdir(parents=True, exist_ok=True)
            shutil.copyfile(REPOSITORY / name, tool / name)
    git(tool, "init", "-q")
    git(tool, "add", ".")
    git(tool, "commit", "-qm", "all")
    revision = git(tool, "rev-parse", "HEAD").strip()
    hooks = f"repos:\n  - repo: {tool.as_uri()}\n    rev: {revision}\n    hooks:\n      - id: shmgen-check\n"
    write(project, {".pre-commit-config.yaml": hooks})
    environment = {**os.environ, "PRE_COMMIT_HOME": str(tmp_path / "kept"), "GIT_CONFIG_GLOBAL": os.devnull}
    pre_commit = [sys.executable, "-m", "pre_commit"]
    subprocess.run([*pre_commit, "install"], cwd=project, env=environment, check=True)
    clean = commit(project, environment)
    if "Could not find a version" in clean.stdout + clean.stderr:
        pytest.skip("no package index in reach")
    assert clean.returncode == 0, clean.stdout + clean.stderr
    assert "shmgen check" in clean.stderr
    assert "Passed" in clean.stderr

    write(project, {"notes.txt": "nothing of ours"})
    unconcerned = commit(project, environment)
    assert (unconcerned.returncode, "no files to check" in unconcerned.stderr) == (0, True)

    write(project, {"msgs/demo_msgs/msg/Robot.msg": ROBOT.replace("float64 speed", "float32 speed")})
    stopped = commit(project, environment)
    assert stopped.returncode == 1
    assert "msgs/demo_msgs/msg/Robot.msg: error[SHM401]: layout of demo_msgs/Robot changed\n" in stopped.stderr, (
        stopped.stderr
    )
    assert "  speed   retyped float64 -> float32\n" in stopped.stderr

    write(project, {".pre-commit-config.yaml": hooks + "      - id: shmgen-generate\n"})
    git(project, "add", ".")
    command = [*pre_commit, "run", "shmgen-generate"]
    written = subprocess.run(command, cwd=project, env=environment, capture_output=True, text=True, check=False)
    assert (written.returncode, "files were modified by this hook" in written.stdout) == (1, True)
    assert commit(project, environment).returncode == 0


def test_the_action_does_what_it_says(project: Path, tmp_path: Path) -> None:
    """Its second step, with the inputs' defaults put in; the first is pip install."""
    action = yaml.safe_load((REPOSITORY / "action.yml").read_text())
    install, check = action["runs"]["steps"]
    assert '"$GITHUB_ACTION_PATH[idl]"' in install["run"]
    tools = tmp_path / "shmgen" / "bin"
    tools.mkdir(parents=True)
    (tools / "shmgen").write_text(f'#!/bin/sh\nexec {sys.executable} -m shmgen "$@"\n')
    (tools / "shmgen").chmod(0o755)
    values = {f"${{{{ inputs.{name} }}}}": str(given["default"]) for name, given in action["inputs"].items()}
    environment = {**os.environ, "RUNNER_TEMP": str(tmp_path)}
    environment |= {name: values[value] for name, value in check["env"].items()}
    step = ["bash", "-e", "-o", "pipefail", "-c", check["run"]]
    folder = project / values[check["working-directory"]]
    assert subprocess.run(step, cwd=folder, env=environment, check=False).returncode == 0
    write(project, {"msgs/demo_msgs/msg/Arm.msg": "int8 a\n"})
    failed = subprocess.run(step, cwd=folder, env=environment, capture_output=True, text=True, check=False)
    assert failed.returncode == 1
    assert failed.stdout.startswith("::error file=msgs/demo_msgs/msg/Arm.msg,title=SHM401 ")


def test_our_own_ci_takes_the_action() -> None:
    workflow = yaml.safe_load((REPOSITORY / ".github" / "workflows" / "ci.yml").read_text())
    assert {"uses": "./"} in workflow["jobs"]["drift"]["steps"]
