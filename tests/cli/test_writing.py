"""Files that meet something on their way: another run, a link, a full disk, a damaged lock, brackets without end."""

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


def configured(folder: Path, bound: int) -> list[str]:
    """The command that generates one message with that bound."""
    text = f'messages = ["geometry_msgs/Polygon"]\ntargets = ["c"]\n[bounds]\n"geometry_msgs/Polygon" = {bound}\n'
    put({f"{bound}.toml": text}, folder)
    return ["generate", "-q", "-c", f"{bound}.toml"]


def interrupted(monkeypatch: pytest.MonkeyPatch, folder: Path, *commands: list[str]) -> None:
    """The next runs find that another one has written in the moment before they write."""
    genuine, left = shmgen.core.write.write, list(commands)

    def write(*arguments: object, **keywords: object) -> object:
        if left:
            assert run(left.pop(), folder).code == 0
        return genuine(*arguments, **keywords)  # type: ignore[arg-type]

    monkeypatch.setattr(shmgen.core.write, "write", write)


@pytest.mark.parametrize("before", [None, 4, 7, 9])
def test_what_is_written_is_of_one_run(monkeypatch: pytest.MonkeyPatch, tmp_path: Path, before: int | None) -> None:
    """Also where the other one has made a file other than it was, and as this one found it."""
    if before:
        assert run(configured(tmp_path, before), tmp_path).code == 0
    four, seven = configured(tmp_path, 4), configured(tmp_path, 7)
    interrupted(monkeypatch, tmp_path, four)
    assert run(seven, tmp_path).code == 0
    assert "points[7]" in (tmp_path / "generated/c/shm_msgs/geometry_msgs/msg/polygon.h").read_text()
    checked = run(["check", "-c", "7.toml"], tmp_path)
    assert (checked.code, checked.stderr) == (0, "")


def test_two_that_join_a_folder_both_stay(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    commands = [["generate", "-q", "-t", "c", f"std_msgs/{name}"] for name in ("Bool", "Int32", "String")]
    interrupted(monkeypatch, tmp_path, *commands[1:])
    assert run(commands[0], tmp_path).code == 0
    assert run(["check", "-t", "c"], tmp_path).stdout == "generated: up to date, 3 messages in 27 files\n"


def test_while_files_are_written_nobody_else_writes(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    staged: list[str] = []

    def stage(name: str, *others: object) -> None:
        staged.append(name)
        folder = os.open(tmp_path / "generated", os.O_RDONLY)
        with pytest.raises(BlockingIOError):
            fcntl.flock(folder, fcntl.LOCK_SH | fcntl.LOCK_NB)
        os.close(folder)
        genuine(name, *others)

    genuine = shmgen.core.write._stage
    monkeypatch.setattr(shmgen.core.write, "_stage", stage)
    assert run(configured(tmp_path, 3), tmp_path).code == 0
    assert staged


@pytest.mark.slow
def test_many_at_once(tmp_path: Path) -> None:
    commands = [configured(tmp_path, bound) for bound in (3, 4, 5, 6)]
    for _ in range(3):
        runs = [subprocess.Popen([sys.executable, "-m", "shmgen", *command], cwd=tmp_path) for command in commands]
        assert [process.wait() for process in runs] == [0, 0, 0, 0]
        clean = [run(["check", "-c", f"{bound}.toml"], tmp_path).code == 0 for bound in (3, 4, 5, 6)]
        assert sum(clean) == 1


def test_what_a_killed_run_staged_goes_though_its_file_was_given_up(tmp_path: Path) -> None:
    assert run(["generate", "-q", "-t", "c", "std_msgs/Bool"], tmp_path).code == 0
    whole = tree(tmp_path)
    stray = "generated/c/shm_msgs/other_msgs/msg/.gone.h.shmgen-abcd_123.tmp"
    mine = "generated/c/shm_msgs/other_msgs/msg/.mine.abcd_123.tmp"
    put({stray: "half", mine: "kept"}, tmp_path)
    said = run(["check", "-t", "c"], tmp_path)
    assert said.code == 1
    assert f"{stray}: error[SHM406]" in said.stderr
    assert run(["generate", "-t", "c", "std_msgs/Bool"], tmp_path).stdout == (
        "generated: 0 files written, 23 unchanged, 1 removed\n"
    )
    (tmp_path / mine).unlink()
    put({stray: "half"}, tmp_path)
    assert run(["generate", "-q", "-t", "c", "std_msgs/Bool"], tmp_path).code == 0
    assert tree(tmp_path) == whole


def test_nothing_is_written_through_a_link(tmp_path: Path) -> None:
    assert run(["generate", "-q", "-t", "c", "std_msgs/Bool"], tmp_path).code == 0
    (tmp_path / "elsewhere").mkdir()
    (tmp_path / "generated/c/shm_msgs/geometry_msgs").symlink_to(tmp_path / "elsewhere")
    before = tree(tmp_path)
    said = run(["generate", "-t", "c", "geometry_msgs/Point"], tmp_path)
    assert said.code == 1
    assert "generated/c/shm_msgs/geometry_msgs is a symbolic link" in said.stderr
    assert "error[SHM007]" in said.stderr
    assert tree(tmp_path) == before


def test_nothing_is_written_through_a_link_that_comes_in_between(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    place, elsewhere = tmp_path / "generated/c/shm_msgs", tmp_path / "elsewhere"
    elsewhere.mkdir()

    def stage(*arguments: object) -> None:
        genuine(*arguments)
        if place.is_dir() and not place.is_symlink():
            place.rename(tmp_path / "moved")
            place.symlink_to(elsewhere)

    genuine = shmgen.core.write._stage
    monkeypatch.setattr(shmgen.core.write, "_stage", stage)
    run(["generate", "-q", "-t", "c", "std_msgs/Bool"], tmp_path)
    assert place.is_symlink()
    assert not list(elsewhere.iterdir())


def test_each_folder_is_opened_to_stage_and_to_rename(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    opened: list[str] = []

    def opening(path: str, flags: int, *rest: int, dir_fd: int | None = None) -> int:
        if flags & os.O_DIRECTORY and dir_fd is not None:
            opened.append(path)
        return genuine(path, flags, *rest, dir_fd=dir_fd)

    genuine = os.open
    monkeypatch.setattr(os, "open", opening)
    assert run(["generate", "-q", "-t", "c", "std_msgs/Bool", "std_msgs/Int8"], tmp_path).code == 0
    assert sorted(opened) == sorted(2 * ["c", "shm_msgs", "std_msgs", "msg"])
    opened.clear()
    assert run(["generate", "-q", "-t", "c", "std_msgs/Bool", "std_msgs/Int8"], tmp_path).code == 0
    assert not opened


def test_a_link_to_the_folder_itself_is_the_users_own(tmp_path: Path) -> None:
    (tmp_path / "elsewhere").mkdir()
    (tmp_path / "generated").symlink_to("elsewhere")
    assert run(["generate", "-q", "-t", "c", "std_msgs/Bool"], tmp_path).code == 0
    assert (tmp_path / "elsewhere/c/shm_msgs/std_msgs/msg/bool.h").is_file()


@pytest.mark.parametrize(
    "command",
    ["list", "types", "show std_msgs/Bool", "show std_msgs/Bool --svg", "explain SHM001", "--help", "check -t c"],
)
@pytest.mark.family("[list]", "[--help]")
def test_a_full_disk_for_what_is_printed(tmp_path: Path, command: str) -> None:
    assert run(["generate", "-q", "-t", "c", "std_msgs/Bool"], tmp_path).code == 0
    for _ in range(2):  # a check that is remembered prints on a way of its own
        with open("/dev/full", "w") as full:
            done = subprocess.run(
                [sys.executable, "-m", "shmgen", *command.split()],
                cwd=tmp_path,
                stdout=full,
                stderr=subprocess.PIPE,
                text=True,
                check=False,
            )
        assert (done.returncode, done.stderr.partition("\n")[0]) == (
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
def test_brackets_without_end(tmp_path: Path, file: str, text: str, command: str, code: str) -> None:
    put({file: text}, tmp_path)
    done = run(command.split(), tmp_path)
    assert done.code == 1
    assert done.stderr.startswith(f"{file}:")
    assert f"error[{code}]" in done.stderr


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
def test_a_damaged_lock_is_told_by_tools(tmp_path: Path, topic: str, damage: str) -> None:
    for name, bound in (("shmgen.toml", 3), ("other.toml", 5)):
        text = f'messages = ["sensor_msgs/JointState"]\n[bounds]\n"sensor_msgs/JointState" = {bound}\n'
        put({name: text}, tmp_path)
    for command in (
        ["generate", "-q", "-t", "c", "sensor_msgs/JointState"],
        ["pub", topic, "sensor_msgs/JointState", "--once"],
    ):
        assert run(command, tmp_path).code == 0
    echo = ["echo", topic, "--once", "-c", "other.toml"]
    assert run(echo, tmp_path).code == 0  # by layout.lock, as shmgen.toml says otherwise
    lock = tmp_path / "generated/layout.lock"
    right, wrong = DAMAGES[damage]
    assert right in lock.read_text()
    lock.write_text(lock.read_text().replace(right, wrong))
    done = run(echo, tmp_path)
    assert (done.code, done.stdout) == (1, "")
    assert done.stderr.startswith("generated/layout.lock: error[SHM408]: layout.lock is damaged")
    done = run(["doctor", topic], tmp_path)  # which goes on without it
    assert (done.code, done.stderr) == (1, "")
    assert f"{topic}  sensor_msgs/msg/JointState, 2 slots, 1 sample" in done.stdout
    assert "  layout: same as shmgen.toml\n" in done.stdout
    fault = "layout.lock is damaged, so shmgen cannot determine the settings of the generated files (SHM408)"
    assert f"this machine\n  fault: {fault}\n" in done.stdout
    assert "    file: generated/layout.lock\n" in done.stdout
    assert done.stdout.endswith("1 region, 1 fault\n")
