"""Test unexpected file types: no command waits forever for a FIFO or writes through a symlink."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import pytest

from shmgen.definitions import folders

from ..support.command import PRELOAD, run

TIMEOUT = 60
"""The timeout of a command in seconds. A command usually takes one second."""


@pytest.mark.parametrize(
    ("fifo", "command"),
    [
        ("shmgen.toml", ["check"]),
        ("shmgen.toml", ["list", "-c", "shmgen.toml"]),
        ("generated/layout.lock", ["check"]),
        ("generated/layout.lock", ["diff", "generated", "generated"]),
        ("generated/layout.lock", ["echo", "/nobody", "--timeout", "0"]),
        ("plant.st", ["import", "plant.st"]),
        ("msgs/package.xml", ["generate", "a_msgs/A", "-I", "msgs"]),
    ],
)
def test_command_does_not_wait_for_a_fifo(fifo: str, command: list[str], tmp_path: Path) -> None:
    (tmp_path / fifo).parent.mkdir(exist_ok=True)
    if fifo != "shmgen.toml":
        (tmp_path / "shmgen.toml").write_text('messages = ["std_msgs/Bool"]\n')
    os.mkfifo(tmp_path / fifo)
    process = subprocess.run(
        [sys.executable, "-m", "shmgen", *command], cwd=tmp_path, timeout=TIMEOUT, capture_output=True
    )
    assert process.returncode == 1
    assert b"SHM901" not in process.stderr


def test_too_many_folders_are_reported(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Lower the limit, because a real case such as `-I /` would take minutes."""
    monkeypatch.setattr(folders, "_MOST_FOLDERS", 20)
    for number in range(30):
        (tmp_path / "many" / str(number)).mkdir(parents=True)
    result = run(["list", "-I", "many"], tmp_path)
    assert (result.code, result.stderr) == (
        1,
        "many: error[SHM001]: more than 20 folders to search\n  hint: give the folder that contains your packages\n",
    )


def test_broken_symlink_is_ignored(tmp_path: Path) -> None:
    """Ignore a symlink whose target cannot be examined, such as /proc/1/root below `-I /`."""
    (tmp_path / "msgs/demo_msgs/msg").mkdir(parents=True)
    (tmp_path / "msgs/demo_msgs/msg/Foo.msg").write_text("int8 x\n")
    for parent in ("msgs", "msgs/demo_msgs/msg"):
        (tmp_path / parent / "link").symlink_to("x" * 300)
    result = run(["list", "-I", "msgs", "demo_msgs"], tmp_path)
    assert (result.code, result.stderr) == (0, "")
    assert result.stdout.endswith("1 of 1 can be generated.\n")


def test_init_does_not_write_through_symlinks(tmp_path: Path) -> None:
    (tmp_path / "here").mkdir()
    (tmp_path / "elsewhere").mkdir()
    (tmp_path / "here" / "shmgen.toml").symlink_to(tmp_path / "elsewhere" / "new.toml")
    (tmp_path / "here" / ".github").symlink_to(tmp_path / "elsewhere")
    result = run(["init", "--ci", "--from", "shmgen"], tmp_path / "here")
    assert (result.code, result.stdout.partition(",")[0]) == (1, "shmgen.toml exists already")
    assert "cannot write: .github is a symbolic link" in result.stderr
    assert not list((tmp_path / "elsewhere").iterdir())


@pytest.mark.parametrize(
    ("error", "expected"),
    [
        (OSError(28, "No space left on device"), "shmgen.toml: error[SHM702]: No space left on device\n"),
        (ValueError("/a: x\x1b[2J"), "/a: error[SHM704]: x\\u001b[2J\n"),
    ],
)
def test_fatal_bridge_error_names_file_or_topic(
    error: Exception, expected: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    from shmgen.bridge import run as run_module

    def raise_error(*_: object) -> None:
        raise error

    (tmp_path / "shmgen.toml").write_text('[[topics]]\ntopic = "/a"\ntype = "std_msgs/Bool"\n')
    monkeypatch.setattr(run_module, "run", raise_error)
    result = run(["bridge"], tmp_path)
    assert (result.code, result.stdout, result.stderr.partition("  hint: ")[0]) == (1, "", expected)


def test_text_of_a_peer_cannot_forge_a_log_line(capsys: pytest.CaptureFixture[str]) -> None:
    from shmgen.cli import bridge

    bridge._tell("/a: a peer says \x1b[2J\nrunning")
    assert capsys.readouterr().err == "/a: a peer says \\u001b[2J\n  running\n"


@pytest.mark.skipif(os.geteuid() != 0, reason="needs root, to become another user")
@pytest.mark.parametrize(
    "command",
    [["check"], ["list"], ["generate", "std_msgs/Bool"], ["show", "-I", "msgs", "a_msgs/A"], ["show", "msgs/A.msg"]],
)
@pytest.mark.family("[command0]", "[command1]")
def test_folder_without_permission_is_reported(command: list[str], tmp_path: Path) -> None:
    """Report SHM001 instead of an internal error. The process loads all modules before it changes the user."""
    (tmp_path / "msgs").mkdir()
    code = f"""{PRELOAD}
os.chdir({str(tmp_path)!r}); os.chmod(".", 0o700)
os.setgroups([]); os.setresgid(65534, 65534, 65534); os.setresuid(65534, 65534, 65534)
sys.argv[1:] = {command!r}
shmgen.cli.main.main()
"""
    process = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, timeout=TIMEOUT)
    assert process.returncode == 1
    assert "error[SHM001]: cannot open: Permission denied" in process.stderr
    assert "run shmgen elsewhere" in process.stderr
