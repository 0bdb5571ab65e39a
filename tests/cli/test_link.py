"""`generate --link`: what another run has written keeps its bounds, and is not written again; and `--only`."""

from __future__ import annotations

import subprocess
import time
from pathlib import Path

import pytest

from shmgen.core.diagnostics import Report
from shmgen.drift import lockfile

from ..support.build import put
from ..support.command import run

TARGETS = ["-t", "c", "-t", "cpp", "-t", "cpp_ros2", "-t", "st", "-t", "plcopen"]
ARM = "arm/shm"
LINKED = ["generate", "-q", *TARGETS, "-I", "arm_msgs", "-I", "cell_msgs", "--only", "cell_msgs", "--link", ARM]


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    put(
        {
            "arm_msgs/msg/Arm.msg": "std_msgs/Header header\nfloat64[] joints\nstring name\n",
            "arm_msgs/msg/Joint.msg": "uint8 one\n",
            "arm_msgs/srv/Stop.srv": "string why\n---\n",
            "cell_msgs/msg/Cell.msg": "arm_msgs/Arm[2] arms\nstring name\n",
            "arm.toml": '[bounds]\n"arm_msgs/Arm.joints" = 6\n[strings]\ndefault = 40\n',
        },
        tmp_path,
    )
    assert (
        run(["generate", "-q", *TARGETS, "-c", "arm.toml", "-I", "arm_msgs", "arm_msgs", "-o", ARM], tmp_path).code == 0
    )
    return tmp_path


def lock(folder: Path) -> lockfile.Lock:
    report = Report()
    found = lockfile.read((folder / "layout.lock").read_text(), "", report)
    assert not report.diagnostics
    return found


def test_what_is_linked_is_the_same_and_not_written_again(folder: Path) -> None:
    assert run(LINKED, folder) == (0, "", "")
    theirs, ours = lock(folder / ARM), lock(folder / "generated")
    assert ours.messages["arm_msgs/msg/Arm"] == theirs.messages["arm_msgs/msg/Arm"]
    assert ours.messages["cell_msgs/msg/Cell"].fields["name"].type == "string<=80"  # its own run's default
    assert {path for path in ours.files if "cell_msgs" not in path} == {
        "plcopen/import_shmgen.py",
        "plcopen/shmgen.xml",
    }
    assert not set(ours.files) & set(theirs.files) - {"plcopen/import_shmgen.py", "plcopen/shmgen.xml"}
    assert "FB_arm_msgs_Arm_Publisher" in (folder / "generated/plcopen/shmgen.xml").read_text()  # one file is imported
    source = '#include "shm_msgs/cell_msgs/msg/cell.hpp"\nshm_msgs::arm_msgs::msg::ArmPublisher *one;\n'
    command = ["g++", "-std=c++17", "-fsyntax-only", "-xc++", "-", "-Igenerated/cpp", f"-I{ARM}/cpp"]
    done = subprocess.run(command, cwd=folder, input=source, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr


@pytest.mark.parametrize(
    ("words", "said"),
    [
        ('[bounds]\n"arm_msgs/Arm.joints" = 7\n', "joints   count 6 -> 7"),
        ('[types]\ntime = "LTIME"\n', "header            grew 48 -> 56"),
    ],
)
def test_another_layout_is_refused_with_the_field(folder: Path, words: str, said: str) -> None:
    put({"shmgen.toml": words}, folder)
    done = run(LINKED, folder)
    assert done.code == 1
    assert f"{ARM}/layout.lock: error[SHM401]: layout of arm_msgs/Arm changed" in done.stderr
    assert f"\n  {said}" in done.stderr
    assert not (folder / "generated").exists()


def test_a_folder_without_lock_is_named(folder: Path) -> None:
    done = run([*LINKED[:-1], "cell_msgs"], folder)
    assert (done.code, done.stderr.splitlines()[0]) == (1, "cell_msgs: error[SHM407]: layout.lock is missing")


def test_only_removes_what_was_asked_for_before(folder: Path) -> None:
    ask = ["generate", "-q", "-t", "c", "-I", "arm_msgs"]
    for command in ([*ask, "arm_msgs/Joint"], [*ask, "std_msgs/Bool"]):
        assert run(command, folder).code == 0
    assert lock(folder / "generated").requested == ("arm_msgs/msg/Joint", "std_msgs/msg/Bool")
    (folder / "arm_msgs/msg/Joint.msg").unlink()  # nor does it fail for what is no more
    assert run([*ask, "--only", "std_msgs/Bool"], folder) == (0, "", "")
    assert lock(folder / "generated").requested == ("std_msgs/msg/Bool",)
    assert not (folder / "generated/c/shm_msgs/arm_msgs").exists()


def test_the_linked_lock_is_looked_at_each_time(folder: Path) -> None:
    """It is in the depfile, and no answer from the cache outlives it."""
    command = [*LINKED, "--depfile", "X.d"]
    for _ in range(3):
        assert run(command, folder).code == 0
        time.sleep(0.1)
    assert f" {folder}/{ARM}/layout.lock" in (folder / "X.d").read_text()
    put({"arm.toml": '[bounds]\n"arm_msgs/Arm.joints" = 5\n'}, folder)
    assert (
        run(["generate", "-q", *TARGETS, "-c", "arm.toml", "-I", "arm_msgs", "arm_msgs", "-o", ARM], folder).code == 0
    )
    assert run(command, folder).code == 0
    assert lock(folder / "generated").messages["arm_msgs/msg/Arm"].fields["joints"].count == 5
