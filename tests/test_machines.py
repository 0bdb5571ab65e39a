"""The C headers have one layout on four machines, with Debian's cross compilers, and qemu for other processors."""

from __future__ import annotations

import dataclasses
import random
import re
import shutil
import subprocess
from pathlib import Path

import pytest

from shmgen.config import Config, load
from shmgen.core.diagnostics import Report
from shmgen.core.model import Layouts, TypeName
from shmgen.generator import pipeline
from shmgen.targets.c.names import struct_name

from .conftest import REPOSITORY
from .support.build import classes, committed_texts, put
from .support.schemas import random_message

MACHINES = {
    "x86-64": ("gcc", ()),
    "i386": ("i686-linux-gnu-gcc", ("qemu-i386",)),
    "armhf": ("arm-linux-gnueabihf-gcc", ("qemu-arm",)),
    "aarch64": ("aarch64-linux-gnu-gcc", ("qemu-aarch64",)),
}
IMU = TypeName("sensor_msgs", "msg", "Imu")


@pytest.fixture(params=MACHINES)
def machine(request: pytest.FixtureRequest) -> tuple[str, tuple[str, ...]]:
    compiler, emulator = MACHINES[request.param]
    for tool in (compiler, *emulator):
        if shutil.which(tool) is None:
            pytest.skip(f"{tool} is not installed")
    return compiler, emulator


@pytest.fixture(scope="module")
def config() -> Config:
    """The repository's own shmgen.toml."""
    return load(REPOSITORY / "shmgen.toml", "shmgen.toml", Report())


@pytest.fixture(scope="module")
def layouts(config: Config) -> Layouts:
    return pipeline.lay_out(config, config.messages)


def program(layouts: Layouts) -> str:
    """Return a C program that prints all sizes and offsets, and then three members of an Imu from standard input."""
    lines = [f'#include "{path}"' for path in ("shm_msgs/sensor_msgs/msg/imu.h",)]
    lines += [f'#include "{path}"' for path in headers()]
    lines += ["#include <stdio.h>"]  # after the headers that define the POSIX version
    lines += ["int main(void) {", f"    static {struct_name(IMU)} imu;"]
    lines += ["    if (fread(&imu, 1, sizeof imu, stdin) != sizeof imu) return 1;"]
    for name, layout in layouts.items():
        struct = struct_name(name)
        lines.append(f'    printf("{name} %u\\n", (unsigned)sizeof({struct}));')
        for slot in layout.slots:
            lines.append(f'    printf("{name}.{slot.name} %u\\n", (unsigned)offsetof({struct}, {slot.name}));')
    lines += [
        '    printf("%s %.17g %.17g\\n",',
        "        imu.header.frame_id, imu.orientation.w, imu.linear_acceleration_covariance[8]);",
        "    return 0;",
        "}",
    ]
    return "\n".join(lines) + "\n"


def headers() -> dict[str, str]:
    """Return {path below c/: text} of the headers for the messages of the repository's own shmgen.toml."""
    return {path[2:]: text for path, text in committed_texts().items() if path.endswith(".h")}


def compile_program(compiler: str, source: str, include: Path, target: Path) -> subprocess.CompletedProcess[str]:
    command = [compiler, "-static", "-std=c11", "-Wall", "-Wextra", "-Werror", f"-I{include}", "-xc", "-", "-o", target]
    return subprocess.run(command, input=source, text=True, capture_output=True, check=False)


def test_headers_have_the_same_layout_on_all_machines(
    machine: tuple[str, tuple[str, ...]], config: Config, layouts: Layouts, tmp_path: Path
) -> None:
    compiler, emulator = machine
    binary = tmp_path / "layout"
    put(headers(), tmp_path / "c")
    result = compile_program(compiler, program(layouts), tmp_path / "c", binary)
    assert result.returncode == 0, result.stderr
    package = f"shm_{compiler.partition('-')[0]}"
    texts = pipeline.generate(dataclasses.replace(config, package=package, targets=("python",)), config.messages)
    put(texts, tmp_path)
    kind, _, _ = classes(tmp_path, package, IMU)
    message = random_message(layouts[IMU], layouts, random.Random(4))
    payload = kind._from_object(message)
    run = subprocess.run([*emulator, binary], input=bytes(payload), capture_output=True, check=True)
    *printed, values = run.stdout.decode().splitlines()
    expected = []
    for name, layout in layouts.items():
        expected.append(f"{name} {layout.size}")
        expected += [f"{name}.{slot.name} {slot.offset}" for slot in layout.slots]
    assert printed == expected
    frame, orientation, covariance = values.rsplit(" ", 2)
    assert frame == message.header.frame_id
    assert (float(orientation), float(covariance)) == (message.orientation.w, message.linear_acceleration_covariance[8])


@pytest.mark.parametrize("fault", ["no padding", "no packing, no padding"])
def test_i386_needs_explicit_padding_and_packing(fault: str, layouts: Layouts, tmp_path: Path) -> None:
    """Reject headers without them: i386 aligns double to 4 bytes, so the layout differs and an assertion fails."""
    if shutil.which("i686-linux-gnu-gcc") is None:
        pytest.skip("i686-linux-gnu-gcc is not installed")
    for path, text in headers().items():
        unpadded = re.sub(r"^.*\b_pad\d+\b.*\n", "", text, flags=re.MULTILINE)
        if fault.startswith("no packing"):
            unpadded = unpadded.replace("#define SHMGEN_PACKED __attribute__((packed))", "#define SHMGEN_PACKED")
        put({path: unpadded}, tmp_path)
    result = compile_program("i686-linux-gnu-gcc", program_without_padding(layouts), tmp_path, tmp_path / "layout")
    assert "static assertion failed" in result.stderr
    if fault.startswith("no packing"):  # x86-64 does not show the difference
        result = compile_program("gcc", program_without_padding(layouts), tmp_path, tmp_path / "layout")
        assert result.returncode == 0, result.stderr


def program_without_padding(layouts: Layouts) -> str:
    return "\n".join(line for line in program(layouts).splitlines() if "_pad" not in line) + "\n"
