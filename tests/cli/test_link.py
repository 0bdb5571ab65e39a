"""Test `generate --link`, which keeps and does not regenerate the messages of another run, and `--only`."""

from __future__ import annotations

import subprocess
import time
from pathlib import Path

import pytest

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
    return lockfile.read((folder / "layout.lock").read_text(), "")


def test_linked_messages_are_equal_and_not_regenerated(folder: Path) -> None:
    assert run(LINKED, folder) == (0, "", "")
    arm_lock, cell_lock = lock(folder / ARM), lock(folder / "generated")
    assert cell_lock.messages["arm_msgs/msg/Arm"] == arm_lock.messages["arm_msgs/msg/Arm"]
    assert cell_lock.messages["cell_msgs/msg/Cell"].fields["name"].type == "string<=80"  # the default of its own run
    assert {path for path in cell_lock.files if "cell_msgs" not in path} == {
        "plcopen/import_shmgen.py",
        "plcopen/shmgen.xml",
    }
    assert not set(cell_lock.files) & set(arm_lock.files) - {"plcopen/import_shmgen.py", "plcopen/shmgen.xml"}
    assert "FB_arm_msgs_Arm_Publisher" in (folder / "generated/plcopen/shmgen.xml").read_text()  # the file to import
    source = '#include "shm_msgs/cell_msgs/msg/cell.hpp"\nshm_msgs::arm_msgs::msg::ArmPublisher *one;\n'
    command = ["g++", "-std=c++17", "-fsyntax-only", "-xc++", "-", "-Igenerated/cpp", f"-I{ARM}/cpp"]
    result = subprocess.run(command, cwd=folder, input=source, capture_output=True, text=True, check=False)
    assert result.returncode == 0, result.stderr


@pytest.mark.parametrize(
    ("toml", "change"),
    [
        ('[bounds]\n"arm_msgs/Arm.joints" = 7\n', "joints   count 6 -> 7"),
        ('[types]\ntime = "LTIME"\n', "header            grew 48 -> 56"),
    ],
)
def test_different_layout_is_rejected_with_the_field(folder: Path, toml: str, change: str) -> None:
    put({"shmgen.toml": toml}, folder)
    result = run(LINKED, folder)
    assert result.code == 1
    assert f"{ARM}/layout.lock: error[SHM401]: layout of arm_msgs/Arm changed" in result.stderr
    assert f"\n  {change}" in result.stderr
    assert not (folder / "generated").exists()


def test_linked_folder_without_lock_is_reported(folder: Path) -> None:
    result = run([*LINKED[:-1], "cell_msgs"], folder)
    assert (result.code, result.stderr.splitlines()[0]) == (1, "cell_msgs: error[SHM407]: layout.lock is missing")


def test_only_removes_former_requests(folder: Path) -> None:
    command_line = ["generate", "-q", "-t", "c", "-I", "arm_msgs"]
    for command in ([*command_line, "arm_msgs/Joint"], [*command_line, "std_msgs/Bool"]):
        assert run(command, folder).code == 0
    assert lock(folder / "generated").requested == ("arm_msgs/msg/Joint", "std_msgs/msg/Bool")
    (folder / "arm_msgs/msg/Joint.msg").unlink()  # a missing former request is not an error
    assert run([*command_line, "--only", "std_msgs/Bool"], folder) == (0, "", "")
    assert lock(folder / "generated").requested == ("std_msgs/msg/Bool",)
    assert not (folder / "generated/c/shm_msgs/arm_msgs").exists()


def test_linked_lock_is_read_in_each_run(folder: Path) -> None:
    """List the linked lock in the depfile, and discard cached output if the lock changes."""
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
