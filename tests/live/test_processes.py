"""Who a process is, as doctor and top tell it."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import pytest

from shmgen.live.processes import bits, called

from ..support import machine


@pytest.mark.parametrize(
    ("emulator", "again", "width"),
    [
        ("/opt/64/qemu-arm-static", False, 32),
        ("/usr/bin/qemu-aarch64", True, 64),
        ("/usr/libexec/qemu-binfmt/riscv64-binfmt-P", True, 64),
        ("/usr/libexec/qemu-binfmt/arm-binfmt-P", True, 32),
    ],
)
def test_an_emulated_process_has_its_own_name_and_width(tmp_path: Path, emulator: str, again: bool, width: int) -> None:
    """/proc tells the emulator's command, with the program and perhaps its own first word behind it."""
    program = tmp_path / "python3"
    program.write_text("echo; read end")
    command = [emulator, *[str(program)] * (1 + again), "talker.py", "4"]
    with subprocess.Popen(command, executable="/bin/sh", stdin=-1, stdout=-1) as process:
        assert process.stdout
        process.stdout.readline()
        assert called(process.pid) == "talker.py 4"
        if not machine.EMULATED:  # there the one that really runs it stands before all that
            assert bits(process.pid) == width
        process.communicate(b"\n")


def test_a_process_has_the_width_of_its_program() -> None:
    assert bits(os.getpid()) == (64 if sys.maxsize > 2**32 else 32)
