"""Test obstacles to writing and reading: another run, a symlink, a full disk, a damaged lock, deep nesting."""

from __future__ import annotations

import fcntl
import os
import subprocess
import sys
from pathlib import Path

import pytest

import shmgen.core.write

from ..support.build import put
from ..support.command import run, tree

DEEP = 5000 * "["


def write_configuration(folder: Path, bound: int) -> list[str]:
    """Write a configuration with this bound, and return the command that generates its message."""
    text = f'messages = ["geometry_msgs/Polygon"]\ntargets = ["c"]\n[bounds]\n"geometry_msgs/Polygon" = {bound}\n'
    put({f"{bound}.toml": text}, folder)
    return ["generate", "-q", "-c", f"{bound}.toml"]


def run_before_write(monkeypatch: pytest.MonkeyPatch, folder: Path, *commands: list[str]) -> None:
    """Let `commands` run and write immediately before the next runs write."""
    original, remaining = shmgen.core.write.write, list(commands)

    def write(*arguments: object, **keywords: object) -> object:
        if remaining:
            assert run(remaining.pop(), folder).code == 0
        return original(*arguments, **keywords)  # type: ignore[arg-type]

    monkeypatch.setattr(shmgen.core.write, "write", write)


@pytest.mark.parametrize("before", [None, 4, 7, 9])
def test_output_comes_from_one_run(monkeypatch: pytest.MonkeyPatch, tmp_path: Path, before: int | None) -> None:
    """Write all files of the interrupted run, whether the other run changed a file or left it unchanged."""
    if before:
        assert run(write_configuration(tmp_path, before), tmp_path).code == 0
    four, seven = write_configuration(tmp_path, 4), write_configuration(tmp_path, 7)
    run_before_write(monkeypatch, tmp_path, four)
    assert run(seven, tmp_path).code == 0
    assert "points[7]" in (tmp_path / "generated/c/shm_msgs/geometry_msgs/msg/polygon.h").read_text()
    check = run(["check", "-c", "7.toml"], tmp_path)
    assert (check.code, check.stderr) == (0, "")


def test_concurrent_runs_keep_all_messages(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    commands = [["generate", "-q", "-t", "c", f"std_msgs/{name}"] for name in ("Bool", "Int32", "String")]
    run_before_write(monkeypatch, tmp_path, *commands[1:])
    assert run(commands[0], tmp_path).code == 0
    assert run(["check", "-t", "c"], tmp_path).stdout == "generated: up to date, 3 messages in 26 files\n"


def test_folder_is_locked_during_writes(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    staged_names: list[str] = []

    def stage(name: str, *others: object) -> None:
        staged_names.append(name)
        folder = os.open(tmp_path / "generated", os.O_RDONLY)
        with pytest.raises(BlockingIOError):
            fcntl.flock(folder, fcntl.LOCK_SH | fcntl.LOCK_NB)
        os.close(folder)
        original(name, *others)

    original = shmgen.core.write._stage
    monkeypatch.setattr(shmgen.core.write, "_stage", stage)
    assert run(write_configuration(tmp_path, 3), tmp_path).code == 0
    assert staged_names


@pytest.mark.slow
def test_four_processes_at_once(tmp_path: Path) -> None:
    commands = [write_configuration(tmp_path, bound) for bound in (3, 4, 5, 6)]
    for _ in range(3):
        runs = [subprocess.Popen([sys.executable, "-m", "shmgen", *command], cwd=tmp_path) for command in commands]
        assert [process.wait() for process in runs] == [0, 0, 0, 0]
        clean = [run(["check", "-c", f"{bound}.toml"], tmp_path).code == 0 for bound in (3, 4, 5, 6)]
        assert sum(clean) == 1


def test_staged_file_of_a_killed_run_is_removed(tmp_path: Path) -> None:
    assert run(["generate", "-q", "-t", "c", "std_msgs/Bool"], tmp_path).code == 0
    clean_tree = tree(tmp_path)
    stray = "generated/c/shm_msgs/other_msgs/msg/.gone.h.shmgen-abcd_123.tmp"
    unrelated = "generated/c/shm_msgs/other_msgs/msg/.mine.abcd_123.tmp"
    put({stray: "half", unrelated: "kept"}, tmp_path)
    result = run(["check", "-t", "c"], tmp_path)
    assert result.code == 1
    assert f"{stray}: error[SHM406]" in result.stderr
    assert run(["generate", "-t", "c", "std_msgs/Bool"], tmp_path).stdout == (
        "generated: 0 files written, 22 unchanged, 1 removed\n"
    )
    (tmp_path / unrelated).unlink()
    put({stray: "half"}, tmp_path)
    assert run(["generate", "-q", "-t", "c", "std_msgs/Bool"], tmp_path).code == 0
    assert tree(tmp_path) == clean_tree


def test_generate_does_not_write_through_a_symlink(tmp_path: Path) -> None:
    assert run(["generate", "-q", "-t", "c", "std_msgs/Bool"], tmp_path).code == 0
    (tmp_path / "elsewhere").mkdir()
    (tmp_path / "generated/c/shm_msgs/geometry_msgs").symlink_to(tmp_path / "elsewhere")
    before = tree(tmp_path)
    result = run(["generate", "-t", "c", "geometry_msgs/Point"], tmp_path)
    assert result.code == 1
    assert "generated/c/shm_msgs/geometry_msgs is a symbolic link" in result.stderr
    assert "error[SHM007]" in result.stderr
    assert tree(tmp_path) == before


def test_symlink_created_during_the_run_is_not_followed(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    place, elsewhere = tmp_path / "generated/c/shm_msgs", tmp_path / "elsewhere"
    elsewhere.mkdir()

    def stage(*arguments: object) -> None:
        original(*arguments)
        if place.is_dir() and not place.is_symlink():
            place.rename(tmp_path / "moved")
            place.symlink_to(elsewhere)

    original = shmgen.core.write._stage
    monkeypatch.setattr(shmgen.core.write, "_stage", stage)
    run(["generate", "-q", "-t", "c", "std_msgs/Bool"], tmp_path)
    assert place.is_symlink()
    assert not list(elsewhere.iterdir())


def test_each_folder_is_opened_twice(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    opened_folders: list[str] = []

    def open_and_record(path: str, flags: int, *rest: int, dir_fd: int | None = None) -> int:
        if flags & os.O_DIRECTORY and dir_fd is not None:
            opened_folders.append(path)
        return original(path, flags, *rest, dir_fd=dir_fd)

    original = os.open
    monkeypatch.setattr(os, "open", open_and_record)
    assert run(["generate", "-q", "-t", "c", "std_msgs/Bool", "std_msgs/Int8"], tmp_path).code == 0
    assert sorted(opened_folders) == sorted(2 * ["c", "shm_msgs", "std_msgs", "msg"])
    opened_folders.clear()
    assert run(["generate", "-q", "-t", "c", "std_msgs/Bool", "std_msgs/Int8"], tmp_path).code == 0
    assert not opened_folders


def test_output_folder_may_be_a_symlink(tmp_path: Path) -> None:
    (tmp_path / "elsewhere").mkdir()
    (tmp_path / "generated").symlink_to("elsewhere")
    assert run(["generate", "-q", "-t", "c", "std_msgs/Bool"], tmp_path).code == 0
    assert (tmp_path / "elsewhere/c/shm_msgs/std_msgs/msg/bool.h").is_file()


@pytest.mark.parametrize(
    "command",
    ["list", "types", "show std_msgs/Bool", "show std_msgs/Bool --svg", "explain SHM001", "--help", "check -t c"],
)
@pytest.mark.family("[list]", "[--help]")
def test_full_disk_of_stdout_is_reported(tmp_path: Path, command: str) -> None:
    assert run(["generate", "-q", "-t", "c", "std_msgs/Bool"], tmp_path).code == 0
    for _ in range(2):  # a cached check uses other code to print
        with open("/dev/full", "w") as full:
            result = subprocess.run(
                [sys.executable, "-m", "shmgen", *command.split()],
                cwd=tmp_path,
                stdout=full,
                stderr=subprocess.PIPE,
                text=True,
                check=False,
            )
        assert (result.returncode, result.stderr.partition("\n")[0]) == (
            1,
            "standard output: error[SHM007]: cannot write: No space left on device",
        )
        run(["check", "-t", "c"], tmp_path)


@pytest.mark.parametrize(
    ("file", "text", "command", "code"),
    [
        ("shmgen.toml", f"messages = {DEEP}", "generate", "SHM503"),
        ("pyproject.toml", f"[tool.shmgen]\npath = {DEEP}{5000 * ']'}", "check", "SHM503"),
        ("generated/layout.lock", f"version = {DEEP}", "check", "SHM408"),
        ("generated/layout.lock", f"version = {5000 * '{a = '}", "generate std_msgs/Bool", "SHM408"),
        ("demo_msgs/msg/A.msg", f"int32[] x {DEEP}\n", "show demo_msgs/A -I .", "SHM006"),
        ("demo_msgs/msg/A.msg", f"int32{DEEP} x\n", "show demo_msgs/A -I .", "SHM003"),
        ("demo_msgs/msg/A.msg", f"string[] x {DEEP}'a'{5000 * ']'}\n", "show demo_msgs/A -I .", "SHM003"),
        ("demo_msgs/msg/A.msg", f"int32 X={DEEP}\n", "show demo_msgs/A -I .", "SHM006"),
    ],
)
def test_thousands_of_brackets_are_rejected(tmp_path: Path, file: str, text: str, command: str, code: str) -> None:
    put({file: text}, tmp_path)
    result = run(command.split(), tmp_path)
    assert result.code == 1
    assert result.stderr.startswith(f"{file}:")
    assert f"error[{code}]" in result.stderr


DAMAGES = {
    "no settings": ("[settings]", "[others]"),
    "no time": ('time = "TIME"\n', ""),
    "a slot": ('"0 ', '"zero '),
    "a digest": ('digest = "', 'digest = "x'),
    "slots": ("slots = [", "solts = ["),
    "no TOML": ("[settings]", "[settings"),
    "a name": ("sensor_msgs/msg/JointState", "JointState"),
}


@pytest.mark.parametrize("damage", DAMAGES)
@pytest.mark.family("[a name]", "[no TOML]")
def test_damaged_lock_is_reported_by_echo_and_doctor(tmp_path: Path, topic: str, damage: str) -> None:
    for name, bound in (("shmgen.toml", 3), ("other.toml", 5)):
        text = f'messages = ["sensor_msgs/JointState"]\n[bounds]\n"sensor_msgs/JointState" = {bound}\n'
        put({name: text}, tmp_path)
    for command in (
        ["generate", "-q", "-t", "c", "sensor_msgs/JointState"],
        ["pub", topic, "sensor_msgs/JointState", "--once"],
    ):
        assert run(command, tmp_path).code == 0
    echo = ["echo", topic, "--once", "-c", "other.toml"]
    assert run(echo, tmp_path).code == 0  # by layout.lock, because shmgen.toml has another bound
    lock = tmp_path / "generated/layout.lock"
    original, damaged = DAMAGES[damage]
    assert original in lock.read_text()
    lock.write_text(lock.read_text().replace(original, damaged))
    result = run(echo, tmp_path)
    assert (result.code, result.stdout) == (1, "")
    assert result.stderr.startswith("generated/layout.lock: error[SHM408]: layout.lock is damaged")
    result = run(["doctor", topic], tmp_path)  # doctor continues without the lock
    assert (result.code, result.stderr) == (1, "")
    assert f"{topic}  sensor_msgs/msg/JointState, 2 slots, 1 sample" in result.stdout
    assert "  layout: same as shmgen.toml\n" in result.stdout
    fault = "layout.lock is damaged, so shmgen cannot determine the settings of the generated files (SHM408)"
    assert f"this machine\n  fault: {fault}\n" in result.stdout
    assert "    file: generated/layout.lock\n" in result.stdout
    assert result.stdout.endswith("1 region, 1 fault\n")
