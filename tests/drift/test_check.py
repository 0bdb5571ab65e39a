"""`check` and `diff` as a user types them: what they find, how they end, and that they write nothing."""

from __future__ import annotations

import json
import os
import shutil
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest

from shmgen.cli import check_cache

from ..support.command import Result, run, tree

SETTINGS = 'messages = ["demo_msgs/Robot"]\npath = ["msgs"]\ntargets = ["c"]\n'
ROBOT = "uint8 AUTO=1\nfloat64 speed\nArm arm\n"
ARM = "float32[<=4] joints\n"


@pytest.fixture
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A workspace with generated headers, and a cache of its own."""
    work = tmp_path / "work"
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "cache"))
    write(work, {"shmgen.toml": SETTINGS, "msgs/demo_msgs/msg/Robot.msg": ROBOT, "msgs/demo_msgs/msg/Arm.msg": ARM})
    assert run(["generate", "-q"], work).code == 0
    return work


def write(folder: Path, files: dict[str, str]) -> None:
    for path, text in files.items():
        (folder / path).parent.mkdir(parents=True, exist_ok=True)
        (folder / path).write_text(text, encoding="utf-8")


def files_of(folder: Path) -> int:
    """How many files were generated there."""
    return sum(file.is_file() for file in (folder / "generated").rglob("*"))


def check(folder: Path, options: str = "") -> Result:
    """And that it changes nothing."""
    before = tree(folder)
    result = run(["check", *options.split()], folder)
    assert tree(folder) == before
    assert "Traceback" not in result.stderr
    return result


def test_clean(folder: Path) -> None:
    assert check(folder) == (0, f"generated: up to date, 2 messages in {files_of(folder)} files\n", "")
    assert check(folder, "--format github") == (0, "", "")
    assert json.loads(check(folder, "--json").stdout) == {"worst": None, "findings": []}


def test_quiet_prints_drift_only(folder: Path) -> None:
    assert check(folder, "--quiet") == check(folder, "-q") == (0, "", "")
    write(folder, {"msgs/demo_msgs/msg/Arm.msg": "float32[<=5] joints\n"})
    assert check(folder, "-q").stderr.startswith("msgs/demo_msgs/msg/Arm.msg: error[SHM401]")


def test_without_configuration_the_lock_says_what_there_is(folder: Path) -> None:
    (folder / "shmgen.toml").unlink()
    assert check(folder, "-I msgs -t c").code == 0
    assert "SHM004" in check(folder, "-t c").stderr
    shutil.rmtree(folder / "generated")
    assert "SHM407" in check(folder).stderr


EDITS = {
    "breaking": ({"msgs/demo_msgs/msg/Arm.msg": "float32[<=5] joints\n"}, ["SHM401", "SHM401", "SHM403"]),
    "compatible": ({"msgs/demo_msgs/msg/Arm.msg": "float32[<=4] joints  # more\n"}, ["SHM402", "SHM403"]),
    "cosmetic": ({"generated/layout.lock": "# ours\n"}, ["SHM403"]),
}


@pytest.mark.parametrize("severity", EDITS)
@pytest.mark.parametrize("fail_on", EDITS)
def test_the_exit_code_is_chosen_with_fail_on(folder: Path, severity: str, fail_on: str) -> None:
    files, codes = EDITS[severity]
    lock = (folder / "generated/layout.lock").read_text()
    write(folder, {path: text + lock if path.endswith(".lock") else text for path, text in files.items()})
    fails = list(EDITS).index(severity) <= list(EDITS).index(fail_on)
    result = check(folder, f"--fail-on {fail_on}")
    assert (result.code, result.stdout) == (int(fails), "")
    level = "error" if fails else "note"
    assert [code for code in codes if f"{level}[{code}]" not in result.stderr] == []
    assert result.stderr.endswith(f"{len(set(codes))} {severity}\n")  # Robot, which contains Arm, is one of its lines
    data = json.loads(check(folder, "--json").stdout)
    assert data["worst"] == severity
    assert [found["code"] for found in data["findings"]] == codes


def test_files(folder: Path) -> None:
    headers = folder / "generated/c/shm_msgs/demo_msgs/msg"
    (headers / "robot.h").write_text("mine")
    (headers / "arm.h").unlink()
    write(folder, {"generated/notes.txt": "ours"})
    said = check(folder).stderr
    assert "robot.h: error[SHM404]: generated file was edited" in said
    assert "arm.h: error[SHM405]: generated file is missing" in said
    assert "notes.txt" not in said
    write(folder, {"shmgen.toml": SETTINGS.replace("Robot", "Arm")})
    said = check(folder).stderr
    assert "demo_msgs/Robot was removed" in said
    assert "error[SHM406]: 2 generated files are left over" in said
    assert "robot_shm.h" in said
    assert run(["generate", "-q"], folder).code == 0
    assert check(folder).code == 0


def test_what_a_lost_lock_leaves_behind_is_named_and_not_removed(folder: Path) -> None:
    """A message and a target that are gone by then; files of the user, and what shmgen did not sign, are no matter."""
    write(folder, {"shmgen.toml": SETTINGS.replace('"c"', '"c", "st"')})
    assert run(["generate", "-q"], folder).code == 0
    (folder / "generated/layout.lock").unlink()
    write(folder, {"shmgen.toml": SETTINGS.replace("Robot", "Arm"), "generated/c/notes.txt": "ours"})
    said = run(["generate"], folder)
    assert said.code == 0
    stray = "generated/c/shm_msgs/demo_msgs/msg/robot.h"
    assert f"{stray}: not in layout.lock, so it is left over: delete it" in said.stdout
    assert (folder / stray).is_file()
    result = check(folder)
    assert result.code == 1
    assert "error[SHM406]" in result.stderr
    assert "generated files are not in layout.lock" in result.stderr
    for path in ("c/shm_msgs/demo_msgs/msg/robot.h", "st/demo_msgs/ST_demo_msgs_Arm.st"):
        assert path in result.stderr
    assert "notes.txt" not in result.stderr
    shutil.rmtree(folder / "generated/st")
    for file in (folder / "generated/c").rglob("robot*.h"):
        file.unlink()
    assert check(folder).code == 0


def test_json_has_a_stable_shape(folder: Path) -> None:
    write(folder, {"msgs/demo_msgs/msg/Robot.msg": ROBOT.replace("float64 speed", "float32 speed")})
    data = json.loads(check(folder, "--json").stdout)
    assert list(data) == ["worst", "findings"]
    first = data["findings"][0]
    assert list(first) == ["code", "severity", "file", "line", "origin", "message", "hint", "changes", "files"]
    assert data["findings"][1]["code"] == "SHM403"
    stale = data["findings"][1]["files"]
    assert [path for path in stale if not (folder / path).is_file()] == []
    assert "generated/c/shm_msgs/demo_msgs/msg/robot.h" in stale
    assert first["origin"] == "msgs/demo_msgs/msg/Robot.msg"
    assert first["changes"][:2] == [
        {
            "field": "speed",
            "kinds": ["retyped"],
            "text": "retyped float64 -> float32",
            "old_offset": 0,
            "new_offset": 0,
        },
        {"field": "arm", "kinds": ["moved"], "text": "moved 8 -> 4", "old_offset": 8, "new_offset": 4},
    ]


def test_github_shows_it_at_the_definition(folder: Path) -> None:
    write(folder, {"msgs/demo_msgs/msg/Robot.msg": ROBOT.replace("speed", "velocity")})
    first, *_ = check(folder, "--format github").stdout.splitlines()
    title = "title=SHM401 layout of demo_msgs/Robot changed"
    assert first.startswith(f"::error file=msgs/demo_msgs/msg/Robot.msg,{title}::velocity   renamed from speed%0A")
    write(folder, {"msgs/demo_msgs/msg/Robot.msg": f'string LOAD="100%"\n{ROBOT}'})
    assert '::LOAD   constant appeared, string "100%25"%0A' in check(folder, "--format github").stdout
    write(folder, {"msgs/demo_msgs/msg/Robot.msg": "float64[] speed\n"})
    result = check(folder, "--format github")
    place = "file=msgs/demo_msgs/msg/Robot.msg,title=SHM101 unbounded sequence has no fixed size,line=1,col=1"
    assert result.stdout.startswith(f"::error {place}::demo_msgs/Robot.speed%0A")
    assert result.code == 1


def test_diff_shows_the_text(folder: Path) -> None:
    before = tree(folder / "generated")
    write(folder, {"msgs/demo_msgs/msg/Arm.msg": f"{ARM}bool last\n"})
    patch = check(folder, "--diff").stdout
    assert "--- a/generated/c/shm_msgs/demo_msgs/msg/arm.h\n+++ b/generated/c/shm_msgs/demo_msgs/msg/arm.h\n" in patch
    subprocess.run(["git", "apply", "-"], cwd=folder, input=patch, text=True, check=True)
    assert check(folder).code == 0
    assert tree(folder / "generated") != before


def test_what_is_rejected_is_told_as_ever(folder: Path) -> None:
    write(folder, {"msgs/demo_msgs/msg/Arm.msg": "float32[] joints\n"})
    assert "error[SHM101]" in check(folder).stderr
    assert json.loads(check(folder, "--json").stdout)["findings"][0]["code"] == "SHM101"
    write(folder, {"generated/layout.lock": "<<<<<<< ours\n"})
    assert "error[SHM408]" in check(folder).stderr


# --- diff -------------------------------------------------------------------------------------------------


def git(folder: Path, *arguments: str) -> str:
    identity = ["-c", "user.name=a", "-c", "user.email=a@example.org", "-c", "init.defaultBranch=main"]
    done = subprocess.run(["git", *identity, *arguments], cwd=folder, capture_output=True, text=True, check=True)
    return done.stdout


def test_diff_of_locks_and_of_revisions(folder: Path) -> None:
    git(folder, "init", "-q")
    git(folder, "add", ".")
    git(folder, "commit", "-qm", "one")
    shutil.copytree(folder / "generated", folder / "old")
    write(folder, {"msgs/demo_msgs/msg/Robot.msg": ROBOT.replace("Arm arm", "bool[3] flags\nArm arm")})
    assert run(["generate", "-q"], folder).code == 0
    git(folder, "commit", "-qam", "two")
    said = [run(["diff", *pair.split()], folder) for pair in ("old generated", "HEAD~1 HEAD", "HEAD~1 generated")]
    assert {result.code for result in said} == {1}
    rests = {result.stdout.partition(": ")[2] for result in said}
    assert len(rests) == 1
    assert "flags   appeared at 8, bool[3]\n  arm     moved 8 -> 12\n" in rests.pop()
    assert run(["diff", "HEAD", "generated/layout.lock"], folder) == (0, "no difference\n", "")
    assert run(["diff", "HEAD~1", "HEAD", "--fail-on", "breaking", "--json"], folder).code == 1
    below = folder / "msgs"
    assert run(["diff", "HEAD~1", "HEAD", "-o", "../generated"], below).code == 1


@pytest.mark.parametrize("name", ["nowhere", "--output=x", "HEAD", ""])
def test_diff_of_what_is_not_there(folder: Path, name: str) -> None:
    result = run(["diff", "--", name, "generated"], folder)
    assert (result.code, result.stdout) == (1, "")
    assert "error[SHM001]" in result.stderr


# --- killed -----------------------------------------------------------------------------------------------


@pytest.mark.slow
def test_a_killed_run_leaves_each_file_old_or_new(folder: Path) -> None:
    """At whatever time; check says so, and the next run mends it, stray files and all."""
    old = tree(folder / "generated")
    write(
        folder, {"msgs/demo_msgs/msg/Arm.msg": f"{ARM}bool last\n", "shmgen.toml": SETTINGS.replace("c", "python", 1)}
    )
    write(folder, {"shmgen.toml": SETTINGS.replace('"c"', '"c", "python", "st"')})
    shutil.copytree(folder, folder.parent / "whole")
    assert run(["generate", "-q"], folder.parent / "whole").code == 0
    new = tree(folder.parent / "whole" / "generated")
    killed = 0
    for delay in [step * 0.01 for step in range(100)]:
        process = subprocess.Popen([sys.executable, "-m", "shmgen", "generate", "-q"], cwd=folder)
        time.sleep(delay)
        process.send_signal(signal.SIGKILL)
        killed += process.wait() != 0
        found = tree(folder / "generated")
        for path, content in found.items():
            assert content in (old.get(path, b""), new.get(path, b"")) or path.endswith(".tmp"), path
        if found == new:
            break
        assert check(folder).code == 1
    assert killed
    assert run(["generate", "-q"], folder).code == 0
    assert tree(folder / "generated") == new
    assert check(folder).code == 0


@pytest.mark.parametrize("renames", range(0, 9, 2))
def test_a_run_killed_between_two_renames(folder: Path, renames: int) -> None:
    """The same, at the places that a clock seldom hits."""
    write(folder, {"msgs/demo_msgs/msg/Arm.msg": f"{ARM}bool last\n"})
    write(folder, {"shmgen.toml": SETTINGS.replace('"c"', '"c", "python"')})
    shutil.copytree(folder, folder.parent / "whole")
    assert run(["generate", "-q"], folder.parent / "whole").code == 0
    new = tree(folder.parent / "whole" / "generated")
    code = f"""
import os, signal
left, replace = {renames}, os.replace
def counted(source, *others, **keywords):
    global left
    if str(source).endswith(".tmp"):
        if not left: os.kill(os.getpid(), signal.SIGKILL)
        left -= 1
    return replace(source, *others, **keywords)
os.replace = counted
from shmgen.cli import main
main.main()
"""
    done = subprocess.run([sys.executable, "-c", code, "generate", "-q"], cwd=folder, check=False)
    assert done.returncode == -signal.SIGKILL
    said = check(folder).stderr
    assert "error[SHM401]" in said
    assert "error[SHM406]" in said
    assert run(["generate", "-q"], folder).code == 0
    assert tree(folder / "generated") == new
    assert check(folder).code == 0


# --- a check that was clean before ------------------------------------------------------------------------


def recalled(folder: Path, options: str = "", command: str = "check", **environment: str) -> Result:
    """In a process of its own, without leave to load what runs the command in full."""
    code = "import sys; sys.modules['shmgen.cli.main'] = None; from shmgen.__main__ import main; main()"
    words = [sys.executable, "-c", code, *command.split(), *options.split()]
    done = subprocess.run(
        words, cwd=folder, env={**os.environ, **environment}, capture_output=True, text=True, check=False
    )
    return Result(done.returncode, done.stdout, done.stderr)


@pytest.fixture
def remembered(folder: Path) -> Path:
    """A clean check, after the moment in which a file might still have been written."""
    time.sleep(3 * check_cache._TICK / 1e9)
    assert check(folder).code == 0
    assert recalled(folder) == (0, f"generated: up to date, 2 messages in {files_of(folder)} files\n", "")
    return folder


CHANGES = pytest.mark.parametrize(
    ("path", "text"),
    [
        ("msgs/demo_msgs/msg/Arm.msg", "float32[<=9] joints\n"),
        ("msgs/demo_msgs/msg/New.msg", "int8 a\n"),
        ("msgs/other_msgs/msg/New.msg", "int8 a\n"),
        ("msgs/COLCON_IGNORE", ""),
        ("msgs/demo_msgs/package.xml", "<name>other</name>"),
        ("shmgen.toml", SETTINGS + "task_interval = 5\n"),
        ("generated/c/shm_msgs/shmgen.h", "mine"),
        ("generated/c/shm_msgs/demo_msgs/msg/.arm.h.shmgen-abcdefgh.tmp", ""),
        ("generated/layout.lock", ""),
    ],
)


@CHANGES
def test_whatever_changes_the_check_is_made_anew(remembered: Path, path: str, text: str) -> None:
    write(remembered, {path: text})
    assert recalled(remembered).code == 1
    assert recalled(remembered, "--json").code == 1


@pytest.fixture
def generated(folder: Path) -> Path:
    """A generate with nothing to do."""
    time.sleep(3 * check_cache._TICK / 1e9)
    said = run(["generate"], folder)
    assert (
        recalled(folder, command="generate")
        == said
        == (0, f"generated: 0 files written, {files_of(folder)} unchanged\n", "")
    )
    return folder


@CHANGES
def test_whatever_changes_generate_runs(generated: Path, path: str, text: str) -> None:
    write(generated, {path: text})
    assert recalled(generated, command="generate").code == 1


def test_what_generate_has_just_written_is_remembered_as_it_wrote_it(folder: Path) -> None:
    for text in (f"{ARM}bool last\n", f"{ARM}bool best\n"):
        write(folder, {"msgs/demo_msgs/msg/Arm.msg": text})
        time.sleep(3 * check_cache._TICK / 1e9)
        assert run(["generate", "-q"], folder).code == 0
        assert recalled(folder, "-q", "generate") == (0, "", "")
    write(folder, {"generated/c/shm_msgs/demo_msgs/msg/arm.h": "mine"})
    assert recalled(folder, "-q", "generate").code == 1


def test_what_another_run_is_staging_is_not_remembered(folder: Path) -> None:
    write(folder, {"msgs/demo_msgs/msg/Arm.msg": f"{ARM}bool last\n"})
    time.sleep(3 * check_cache._TICK / 1e9)
    code = """
import os, sys
from shmgen.core import write
from shmgen.cli import check_cache
done = check_cache.store
def store(*arguments):
    open("generated/.layout.lock.shmgen-abcdefgh.tmp", "w").close()
    done(*arguments)
check_cache.store = store
from shmgen.cli import main
main.main()
"""
    assert subprocess.run([sys.executable, "-c", code, "generate", "-q"], cwd=folder, check=False).returncode == 0
    assert recalled(folder, "-q", "generate").code == 1


def test_a_depfile_that_is_gone_is_written_again(generated: Path) -> None:
    command = ["generate", "-q", "--depfile", "X.d"]
    assert run(command, generated).code == 0
    time.sleep(3 * check_cache._TICK / 1e9)
    assert run(command, generated).code == 0
    assert recalled(generated, "", " ".join(command)) == (0, "", "")
    (generated / "X.d").unlink()
    assert recalled(generated, "", " ".join(command)).code == 1


@pytest.mark.parametrize(
    ("words", "at", "shell", "known"),
    [
        ("shmgen gen", "1", "bash", True),
        ("shmgen check --fa", "2", "zsh", True),
        ("shmgen ge", "ge", "fish", True),
        ("shmgen show geometry_msgs/Po", "2", "bash", False),
        ("shmgen show ", "", "fish", False),
        ("shmgen echo /a --field x", "4", "bash", False),
    ],
)
def test_what_completes_a_command_or_an_option_is_remembered(
    folder: Path, monkeypatch: pytest.MonkeyPatch, words: str, at: str, shell: str, known: bool
) -> None:
    for name, value in {"COMP_WORDS": words, "COMP_CWORD": at, "_SHMGEN_COMPLETE": f"{shell}_complete"}.items():
        monkeypatch.setenv(name, value)
    program = "import sys; sys.argv[0] = 'shmgen'; from shmgen.__main__ import main; main()"
    done = subprocess.run([sys.executable, "-c", program], cwd=folder, capture_output=True, text=True, check=True)
    again = recalled(folder, command="")
    assert (again.code == 0) == known
    assert not known or again.stdout == done.stdout


def test_the_version_is_remembered_for_each_engine(folder: Path) -> None:
    said = run(["--version"], folder)
    command = [sys.executable, "-m", "shmgen", "--version"]
    first = subprocess.run(command, cwd=folder, capture_output=True, text=True, check=True).stdout
    assert recalled(folder, "", "--version") == (0, first, "") == said
    assert recalled(folder, "", "--version", SHMGEN_PURE="1").code == 1


def test_a_change_that_keeps_size_and_time_is_seen(remembered: Path) -> None:
    file = remembered / "msgs/demo_msgs/msg/Arm.msg"
    state = file.stat()
    file.write_text(ARM.replace("4", "5"))
    os.utime(file, ns=(state.st_atime_ns, state.st_mtime_ns))
    assert recalled(remembered).code == 1


def test_what_changes_while_it_is_checked_is_not_remembered(folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(check_cache, "_TICK", 10**9)  # so that a busy machine does not take longer before it begins
    (folder / "msgs/demo_msgs/msg/Arm.msg").touch()
    assert check(folder).code == 0
    assert recalled(folder).code == 1


def test_a_damaged_memory_is_none(remembered: Path) -> None:
    (kept,) = (remembered.parent / "cache/shmgen").glob("clean-*")
    kept.write_bytes(b"\xff")
    assert recalled(remembered).code == 1


def test_only_the_newest_are_kept(folder: Path) -> None:
    time.sleep(3 * check_cache._TICK / 1e9)
    for number in range(25):
        assert check(folder, f"-I {'./' * number}msgs").code == 0
    assert len(list((folder.parent / "cache/shmgen").glob("clean-*"))) == check_cache._MAX_ENTRIES
