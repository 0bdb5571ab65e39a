"""Tests of the commands `check` and `diff`: their findings, exit codes and formats, and that they write nothing."""

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
    """A workspace with generated headers, and a separate cache."""
    work = tmp_path / "work"
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "cache"))
    write(work, {"shmgen.toml": SETTINGS, "msgs/demo_msgs/msg/Robot.msg": ROBOT, "msgs/demo_msgs/msg/Arm.msg": ARM})
    assert run(["generate", "-q"], work).code == 0
    return work


def write(folder: Path, files: dict[str, str]) -> None:
    for path, text in files.items():
        (folder / path).parent.mkdir(parents=True, exist_ok=True)
        (folder / path).write_text(text, encoding="utf-8")


def count_generated(folder: Path) -> int:
    """Return the number of generated files."""
    return sum(file.is_file() for file in (folder / "generated").rglob("*"))


def check(folder: Path, options: str = "") -> Result:
    """Run `shmgen check`, and assert that no file changed."""
    before = tree(folder)
    result = run(["check", *options.split()], folder)
    assert tree(folder) == before
    assert "Traceback" not in result.stderr
    return result


def test_unchanged_workspace_is_up_to_date(folder: Path) -> None:
    assert check(folder) == (0, f"generated: up to date, 2 messages in {count_generated(folder)} files\n", "")
    assert check(folder, "--format github") == (0, "", "")
    assert json.loads(check(folder, "--json").stdout) == {"worst": None, "findings": []}


def test_quiet_check_prints_only_findings(folder: Path) -> None:
    assert check(folder, "--quiet") == check(folder, "-q") == (0, "", "")
    write(folder, {"msgs/demo_msgs/msg/Arm.msg": "float32[<=5] joints\n"})
    assert check(folder, "-q").stderr.startswith("msgs/demo_msgs/msg/Arm.msg: error[SHM401]")


def test_without_shmgen_toml_the_lock_lists_the_messages(folder: Path) -> None:
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
def test_fail_on_selects_the_exit_code(folder: Path, severity: str, fail_on: str) -> None:
    files, codes = EDITS[severity]
    lock = (folder / "generated/layout.lock").read_text()
    write(folder, {path: text + lock if path.endswith(".lock") else text for path, text in files.items()})
    is_failure = list(EDITS).index(severity) <= list(EDITS).index(fail_on)
    result = check(folder, f"--fail-on {fail_on}")
    assert (result.code, result.stdout) == (int(is_failure), "")
    level = "error" if is_failure else "note"
    assert [code for code in codes if f"{level}[{code}]" not in result.stderr] == []
    assert result.stderr.endswith(f"{len(set(codes))} {severity}\n")  # Arm's finding includes Robot, which has an Arm
    data = json.loads(check(folder, "--json").stdout)
    assert data["worst"] == severity
    assert [finding["code"] for finding in data["findings"]] == codes


def test_edited_missing_and_leftover_files_are_reported(folder: Path) -> None:
    headers = folder / "generated/c/shm_msgs/demo_msgs/msg"
    (headers / "robot.h").write_text("mine")
    (headers / "arm.h").unlink()
    write(folder, {"generated/notes.txt": "ours"})
    stderr = check(folder).stderr
    assert "robot.h: error[SHM404]: generated file was edited" in stderr
    assert "arm.h: error[SHM405]: generated file is missing" in stderr
    assert "notes.txt" not in stderr
    write(folder, {"shmgen.toml": SETTINGS.replace("Robot", "Arm")})
    stderr = check(folder).stderr
    assert "demo_msgs/Robot was removed" in stderr
    assert "error[SHM406]: 2 generated files are left over" in stderr
    assert "robot_shm.h" in stderr
    assert run(["generate", "-q"], folder).code == 0
    assert check(folder).code == 0


def test_files_unknown_to_a_new_lock_are_reported_and_kept(folder: Path) -> None:
    """Report only generated files without an entry in the lock. Ignore the user's files."""
    write(folder, {"shmgen.toml": SETTINGS.replace('"c"', '"c", "st"')})
    assert run(["generate", "-q"], folder).code == 0
    (folder / "generated/layout.lock").unlink()
    write(folder, {"shmgen.toml": SETTINGS.replace("Robot", "Arm"), "generated/c/notes.txt": "ours"})
    generate_result = run(["generate"], folder)
    assert generate_result.code == 0
    leftover = "generated/c/shm_msgs/demo_msgs/msg/robot.h"
    assert f"{leftover}: not in layout.lock: delete this file" in generate_result.stdout
    assert (folder / leftover).is_file()
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


def test_json_output_has_stable_keys(folder: Path) -> None:
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


def test_github_annotation_points_at_the_definition(folder: Path) -> None:
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


def test_option_diff_prints_a_patch_that_git_applies(folder: Path) -> None:
    before = tree(folder / "generated")
    write(folder, {"msgs/demo_msgs/msg/Arm.msg": f"{ARM}bool last\n"})
    patch = check(folder, "--diff").stdout
    assert "--- a/generated/c/shm_msgs/demo_msgs/msg/arm.h\n+++ b/generated/c/shm_msgs/demo_msgs/msg/arm.h\n" in patch
    subprocess.run(["git", "apply", "-"], cwd=folder, input=patch, text=True, check=True)
    assert check(folder).code == 0
    assert tree(folder / "generated") != before


def test_invalid_definition_or_lock_is_reported(folder: Path) -> None:
    write(folder, {"msgs/demo_msgs/msg/Arm.msg": "float32[] joints\n"})
    assert "error[SHM101]" in check(folder).stderr
    assert json.loads(check(folder, "--json").stdout)["findings"][0]["code"] == "SHM101"
    write(folder, {"generated/layout.lock": "<<<<<<< ours\n"})
    assert "error[SHM408]" in check(folder).stderr


# --- diff -------------------------------------------------------------------------------------------------


def git(folder: Path, *arguments: str) -> str:
    identity = ["-c", "user.name=a", "-c", "user.email=a@example.org", "-c", "init.defaultBranch=main"]
    result = subprocess.run(["git", *identity, *arguments], cwd=folder, capture_output=True, text=True, check=True)
    return result.stdout


def test_diff_compares_locks_and_git_revisions(folder: Path) -> None:
    git(folder, "init", "-q")
    git(folder, "add", ".")
    git(folder, "commit", "-qm", "one")
    shutil.copytree(folder / "generated", folder / "old")
    write(folder, {"msgs/demo_msgs/msg/Robot.msg": ROBOT.replace("Arm arm", "bool[3] flags\nArm arm")})
    assert run(["generate", "-q"], folder).code == 0
    git(folder, "commit", "-qam", "two")
    results = [run(["diff", *pair.split()], folder) for pair in ("old generated", "HEAD~1 HEAD", "HEAD~1 generated")]
    assert {result.code for result in results} == {1}
    changes = {result.stdout.partition(": ")[2] for result in results}
    assert len(changes) == 1
    assert "flags   appeared at 8, bool[3]\n  arm     moved 8 -> 12\n" in changes.pop()
    assert run(["diff", "HEAD", "generated/layout.lock"], folder) == (0, "no difference\n", "")
    assert run(["diff", "HEAD~1", "HEAD", "--fail-on", "breaking", "--json"], folder).code == 1
    subfolder = folder / "msgs"
    assert run(["diff", "HEAD~1", "HEAD", "-o", "../generated"], subfolder).code == 1


@pytest.mark.parametrize("name", ["nowhere", "--output=x", "HEAD", ""])
def test_diff_rejects_an_unknown_lock_or_revision(folder: Path, name: str) -> None:
    result = run(["diff", "--", name, "generated"], folder)
    assert (result.code, result.stdout) == (1, "")
    assert "error[SHM001]" in result.stderr


# --- killed -----------------------------------------------------------------------------------------------


@pytest.mark.slow
def test_killed_generate_leaves_each_file_old_or_new(folder: Path) -> None:
    """Report an incomplete run in `check`. The next run completes all files and removes temporary files."""
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
        files = tree(folder / "generated")
        for path, content in files.items():
            assert content in (old.get(path, b""), new.get(path, b"")) or path.endswith(".tmp"), path
        if files == new:
            break
        assert check(folder).code == 1
    assert killed
    assert run(["generate", "-q"], folder).code == 0
    assert tree(folder / "generated") == new
    assert check(folder).code == 0


@pytest.mark.parametrize("renames", range(0, 9, 2))
@pytest.mark.family("[4]")
def test_generate_killed_between_two_renames_is_completed(folder: Path, renames: int) -> None:
    """Stop the process between two renames, because a timed kill seldom hits these moments."""
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
    process = subprocess.run([sys.executable, "-c", code, "generate", "-q"], cwd=folder, check=False)
    assert process.returncode == -signal.SIGKILL
    stderr = check(folder).stderr
    assert "error[SHM401]" in stderr
    assert "error[SHM406]" in stderr
    assert run(["generate", "-q"], folder).code == 0
    assert tree(folder / "generated") == new
    assert check(folder).code == 0


# --- cached output ---------------------------------------------------------------------------------------


def run_from_cache(folder: Path, options: str = "", command: str = "check", **environment: str) -> Result:
    """Run a command in a new process that fails unless the cache answers."""
    code = "import sys; sys.modules['shmgen.cli.main'] = None; from shmgen.__main__ import main; main()"
    arguments = [sys.executable, "-c", code, *command.split(), *options.split()]
    process = subprocess.run(
        arguments, cwd=folder, env={**os.environ, **environment}, capture_output=True, text=True, check=False
    )
    return Result(process.returncode, process.stdout, process.stderr)


@pytest.fixture
def cached_check(folder: Path) -> Path:
    """A workspace whose clean check is cached, because its files are old enough."""
    time.sleep(3 * check_cache._TICK / 1e9)
    assert check(folder).code == 0
    assert run_from_cache(folder) == (0, f"generated: up to date, 2 messages in {count_generated(folder)} files\n", "")
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
def test_changed_input_invalidates_the_cached_check(cached_check: Path, path: str, text: str) -> None:
    write(cached_check, {path: text})
    assert run_from_cache(cached_check).code == 1
    assert run_from_cache(cached_check, "--json").code == 1


@pytest.fixture
def generated(folder: Path) -> Path:
    """A workspace in which the output of `generate` with nothing to do is cached."""
    time.sleep(3 * check_cache._TICK / 1e9)
    result = run(["generate"], folder)
    assert (
        run_from_cache(folder, command="generate")
        == result
        == (0, f"generated: 0 files written, {count_generated(folder)} unchanged\n", "")
    )
    return folder


@CHANGES
def test_changed_input_invalidates_the_cached_generate(generated: Path, path: str, text: str) -> None:
    write(generated, {path: text})
    assert run_from_cache(generated, command="generate").code == 1


def test_deleted_depfile_invalidates_the_cached_generate(generated: Path) -> None:
    command = ["generate", "-q", "--depfile", "X.d"]
    assert run(command, generated).code == 0
    time.sleep(3 * check_cache._TICK / 1e9)
    assert run(command, generated).code == 0
    assert run_from_cache(generated, "", " ".join(command)) == (0, "", "")
    (generated / "X.d").unlink()
    assert run_from_cache(generated, "", " ".join(command)).code == 1


@pytest.mark.parametrize(
    ("line", "at", "shell", "is_cached"),
    [
        ("shmgen gen", "1", "bash", True),
        ("shmgen check --fa", "2", "zsh", True),
        ("shmgen ge", "ge", "fish", True),
        ("shmgen show geometry_msgs/Po", "2", "bash", False),
        ("shmgen show ", "", "fish", False),
        ("shmgen echo /a --field x", "4", "bash", False),
    ],
)
def test_shell_completion_of_commands_and_options_is_cached(
    folder: Path, monkeypatch: pytest.MonkeyPatch, line: str, at: str, shell: str, is_cached: bool
) -> None:
    for name, value in {"COMP_WORDS": line, "COMP_CWORD": at, "_SHMGEN_COMPLETE": f"{shell}_complete"}.items():
        monkeypatch.setenv(name, value)
    program = "import sys; sys.argv[0] = 'shmgen'; from shmgen.__main__ import main; main()"
    first = subprocess.run([sys.executable, "-c", program], cwd=folder, capture_output=True, text=True, check=True)
    cached = run_from_cache(folder, command="")
    assert (cached.code == 0) == is_cached
    assert not is_cached or cached.stdout == first.stdout


def test_version_is_cached_for_each_engine(folder: Path) -> None:
    result = run(["--version"], folder)
    command = [sys.executable, "-m", "shmgen", "--version"]
    first = subprocess.run(command, cwd=folder, capture_output=True, text=True, check=True).stdout
    assert run_from_cache(folder, "", "--version") == (0, first, "") == result
    assert run_from_cache(folder, "", "--version", SHMGEN_PURE="1").code == 1


def test_change_that_keeps_size_and_time_is_detected(cached_check: Path) -> None:
    file = cached_check / "msgs/demo_msgs/msg/Arm.msg"
    state = file.stat()
    file.write_text(ARM.replace("4", "5"))
    os.utime(file, ns=(state.st_atime_ns, state.st_mtime_ns))
    assert run_from_cache(cached_check).code == 1


def test_file_changed_during_a_check_prevents_caching(folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(check_cache, "_TICK", 10**9)  # the touched file counts as new even on a slow machine
    (folder / "msgs/demo_msgs/msg/Arm.msg").touch()
    assert check(folder).code == 0
    assert run_from_cache(folder).code == 1


def test_damaged_cache_entry_is_ignored(cached_check: Path) -> None:
    (entry,) = (cached_check.parent / "cache/shmgen").glob("clean-*")
    entry.write_bytes(b"\xff")
    assert run_from_cache(cached_check).code == 1


def test_cache_keeps_only_the_newest_entries(folder: Path) -> None:
    time.sleep(3 * check_cache._TICK / 1e9)
    for number in range(25):
        assert check(folder, f"-I {'./' * number}msgs").code == 0
    assert len(list((folder.parent / "cache/shmgen").glob("clean-*"))) == check_cache._MAX_ENTRIES
