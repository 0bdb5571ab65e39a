"""Test the hooks with the real pre-commit, and run the steps of action.yml."""

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
    """A repository whose generated files are up to date."""
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
def test_pre_commit_rejects_a_changed_layout(project: Path, tmp_path: Path) -> None:
    """Install shmgen by pip into pre-commit's environment, from a repository with the files of this checkout."""
    import_or_skip("pre_commit")
    tool = tmp_path / "tool"
    files = subprocess.run(
        ["git", "ls-files", "-z", "--cached", "--others", "--exclude-standard"],
        cwd=REPOSITORY,
        capture_output=True,
        check=False,
    )
    if files.returncode:
        pytest.skip("this folder is not a git checkout")
    for name in filter(None, files.stdout.decode().split("\0")):
        is_needed = name.startswith(("src/", "templates/", ".pre-commit")) or name in (
            "pyproject.toml",
            "hatch_build.py",
            "README.md",
            "LICENSE",
        )
        if is_needed and (REPOSITORY / name).is_file():
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
        pytest.skip("no package index is reachable")
    assert clean.returncode == 0, clean.stdout + clean.stderr
    assert "shmgen check" in clean.stderr
    assert "Passed" in clean.stderr

    write(project, {"notes.txt": "nothing of ours"})
    unrelated = commit(project, environment)
    assert (unrelated.returncode, "no files to check" in unrelated.stderr) == (0, True)

    write(project, {"msgs/demo_msgs/msg/Robot.msg": ROBOT.replace("float64 speed", "float32 speed")})
    rejected = commit(project, environment)
    assert rejected.returncode == 1
    assert "msgs/demo_msgs/msg/Robot.msg: error[SHM401]: layout of demo_msgs/Robot changed\n" in rejected.stderr, (
        rejected.stderr
    )
    assert "  speed   retyped float64 -> float32\n" in rejected.stderr

    write(project, {".pre-commit-config.yaml": hooks + "      - id: shmgen-generate\n"})
    git(project, "add", ".")
    command = [*pre_commit, "run", "shmgen-generate"]
    generated = subprocess.run(command, cwd=project, env=environment, capture_output=True, text=True, check=False)
    assert (generated.returncode, "files were modified by this hook" in generated.stdout) == (1, True)
    assert commit(project, environment).returncode == 0


def test_action_reports_a_changed_layout(project: Path, tmp_path: Path) -> None:
    """Run the second step with the default inputs. The first step is pip install."""
    action = yaml.safe_load((REPOSITORY / "action.yml").read_text())
    install, check = action["runs"]["steps"]
    assert '"$GITHUB_ACTION_PATH[idl]"' in install["run"]
    tools = tmp_path / "shmgen" / "bin"
    tools.mkdir(parents=True)
    (tools / "shmgen").write_text(f'#!/bin/sh\nexec {sys.executable} -m shmgen "$@"\n')
    (tools / "shmgen").chmod(0o755)
    values = {f"${{{{ inputs.{name} }}}}": str(definition["default"]) for name, definition in action["inputs"].items()}
    environment = {**os.environ, "RUNNER_TEMP": str(tmp_path)}
    environment |= {name: values[value] for name, value in check["env"].items()}
    step = ["bash", "-e", "-o", "pipefail", "-c", check["run"]]
    folder = project / values[check["working-directory"]]
    assert subprocess.run(step, cwd=folder, env=environment, check=False).returncode == 0
    write(project, {"msgs/demo_msgs/msg/Arm.msg": "int8 a\n"})
    failure = subprocess.run(step, cwd=folder, env=environment, capture_output=True, text=True, check=False)
    assert failure.returncode == 1
    assert failure.stdout.startswith("::error file=msgs/demo_msgs/msg/Arm.msg,title=SHM401 ")


def test_ci_uses_the_action() -> None:
    workflow = yaml.safe_load((REPOSITORY / ".github" / "workflows" / "ci.yml").read_text())
    assert {"uses": "./"} in workflow["jobs"]["drift"]["steps"]
