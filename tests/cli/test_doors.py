"""What lies where a file is expected: no command waits for ever for it, or writes through it."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import pytest

from shmgen.definitions import folders

from ..support.command import PRELOAD, run

SECONDS = 60
"""A guard against hanging: each takes one."""


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
def test_a_fifo_is_not_waited_for(fifo: str, command: list[str], tmp_path: Path) -> None:
    (tmp_path / fifo).parent.mkdir(exist_ok=True)
    if fifo != "shmgen.toml":
        (tmp_path / "shmgen.toml").write_text('messages = ["std_msgs/Bool"]\n')
    os.mkfifo(tmp_path / fifo)
    done = subprocess.run(
        [sys.executable, "-m", "shmgen", *command], cwd=tmp_path, timeout=SECONDS, capture_output=True
    )
    assert done.returncode == 1
    assert b"SHM901" not in done.stderr


def test_too_many_folders_are_told(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """As `-I /` has; on this machine it would take minutes."""
    monkeypatch.setattr(folders, "_MOST_FOLDERS", 20)
    for number in range(30):
        (tmp_path / "many" / str(number)).mkdir(parents=True)
    said = run(["list", "-I", "many"], tmp_path)
    assert (said.code, said.stderr) == (
        1,
        "many: error[SHM001]: more than 20 folders to search\n  hint: give the folder that contains your packages\n",
    )


def test_a_link_that_leads_nowhere_is_passed_over(tmp_path: Path) -> None:
    """As /proc/1/root is for most, below `-I /`: its target cannot even be asked about."""
    (tmp_path / "msgs/demo_msgs/msg").mkdir(parents=True)
    (tmp_path / "msgs/demo_msgs/msg/Foo.msg").write_text("int8 x\n")
    for place in ("msgs", "msgs/demo_msgs/msg"):
        (tmp_path / place / "link").symlink_to("x" * 300)
    said = run(["list", "-I", "msgs", "demo_msgs"], tmp_path)
    assert (said.code, said.stderr) == (0, "")
    assert said.stdout.endswith("1 of 1 can be generated.\n")


def test_init_does_not_write_through_links(tmp_path: Path) -> None:
    (tmp_path / "here").mkdir()
    (tmp_path / "elsewhere").mkdir()
    (tmp_path / "here" / "shmgen.toml").symlink_to(tmp_path / "elsewhere" / "new.toml")
    (tmp_path / "here" / ".github").symlink_to(tmp_path / "elsewhere")
    said = run(["init", "--ci", "--from", "shmgen"], tmp_path / "here")
    assert (said.code, said.stdout.partition(",")[0]) == (1, "shmgen.toml is there")
    assert "cannot write: .github is a symbolic link" in said.stderr
    assert not list((tmp_path / "elsewhere").iterdir())


@pytest.mark.parametrize(
    ("raised", "told"),
    [
        (OSError(28, "No space left on device"), "shmgen.toml: error[SHM702]: No space left on device\n"),
        (ValueError("/a: x\x1b[2J"), "/a: error[SHM704]: x\\u001b[2J\n"),
    ],
)
def test_what_ends_a_bridge_is_told_by_its_name(
    raised: Exception, told: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    from shmgen.bridge import run as running

    def fails(*_: object) -> None:
        raise raised

    (tmp_path / "shmgen.toml").write_text('[[topics]]\ntopic = "/a"\ntype = "std_msgs/Bool"\n')
    monkeypatch.setattr(running, "run", fails)
    said = run(["bridge"], tmp_path)
    assert (said.code, said.stdout, said.stderr.partition("  hint: ")[0]) == (1, "", told)


def test_a_peer_begins_no_line_of_the_bridges_log(capsys: pytest.CaptureFixture[str]) -> None:
    from shmgen.cli import bridge

    bridge._tell("/a: a peer says \x1b[2J\nrunning")
    assert capsys.readouterr().err == "/a: a peer says \\u001b[2J\n  running\n"


@pytest.mark.skipif(os.geteuid() != 0, reason="needs root, to become another user")
@pytest.mark.parametrize(
    "command",
    [["check"], ["list"], ["generate", "std_msgs/Bool"], ["show", "-I", "msgs", "a_msgs/A"], ["show", "msgs/A.msg"]],
)
@pytest.mark.family("[command0]", "[command1]")
def test_a_folder_that_the_user_may_not_search_is_named(command: list[str], tmp_path: Path) -> None:
    """Not SHM901, a fault of shmgen. What the command loads is loaded before this process becomes the other user."""
    (tmp_path / "msgs").mkdir()
    code = f"""{PRELOAD}
os.chdir({str(tmp_path)!r}); os.chmod(".", 0o700)
os.setgroups([]); os.setresgid(65534, 65534, 65534); os.setresuid(65534, 65534, 65534)
sys.argv[1:] = {command!r}
shmgen.cli.main.main()
"""
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, timeout=SECONDS)
    assert done.returncode == 1
    assert "error[SHM001]: cannot open: Permission denied" in done.stderr
    assert "run shmgen elsewhere" in done.stderr
