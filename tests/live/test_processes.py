"""The tools doctor and top show the command and the word size of a process."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import pytest

from shmgen.live.processes import bits, called

from ..support import machine


@pytest.mark.parametrize(
    ("emulator", "twice", "width"),
    [
        ("/opt/64/qemu-arm-static", False, 32),
        ("/usr/bin/qemu-aarch64", True, 64),
        ("/usr/libexec/qemu-binfmt/riscv64-binfmt-P", True, 64),
        ("/usr/libexec/qemu-binfmt/arm-binfmt-P", True, 32),
    ],
)
def test_emulated_process_has_its_own_command_and_bits(tmp_path: Path, emulator: str, twice: bool, width: int) -> None:
    """Skip the emulator in the command of /proc, in which the program follows once or twice."""
    program = tmp_path / "python3"
    program.write_text("echo; read end")
    command = [emulator, *[str(program)] * (1 + twice), "talker.py", "4"]
    with subprocess.Popen(command, executable="/bin/sh", stdin=-1, stdout=-1) as process:
        assert process.stdout
        process.stdout.readline()
        assert called(process.pid) == "talker.py 4"
        if not machine.EMULATED:  # under emulation, the actual emulator precedes this command
            assert bits(process.pid) == width
        process.communicate(b"\n")


def test_process_has_the_bits_of_its_program() -> None:
    assert bits(os.getpid()) == (64 if sys.maxsize > 2**32 else 32)
