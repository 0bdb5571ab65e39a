"""Builds the C++ benchmark programs: peers/cpp.cpp with generated code, and the iceoryx peer."""

from __future__ import annotations

import subprocess
from pathlib import Path

from shmgen.config import Config
from shmgen.generator import pipeline

ICEORYX = "/usr/include/iceoryx/v2.0.3"
SIZES = {"Block56": 56, "Block320": 320, "Mebibyte": 1 << 20}


def program(folder: Path) -> Path:
    """Compile peers/cpp.cpp in `folder` with -O2 and return the path of the program."""
    for name, size in SIZES.items():
        file = folder / "definitions" / "bench_msgs" / "msg" / f"{name}.msg"
        file.parent.mkdir(parents=True, exist_ok=True)
        file.write_text(f"uint64[{size // 8}] data\n")
    types = [f"bench_msgs/{name}" for name in SIZES]
    config = Config(folder, path=(folder / "definitions",), targets=("cpp",))
    for path, text in pipeline.generate(config, [*types, "geometry_msgs/Pose"]).items():
        file = folder / path
        file.parent.mkdir(parents=True, exist_ok=True)
        file.write_text(text)
    program = folder / "cpp_peer"
    source = Path(__file__).with_name("cpp.cpp")
    subprocess.run(["g++", "-O2", "-std=c++17", f"-I{folder / 'cpp'}", source, "-pthread", "-o", program], check=True)
    return program


def iceoryx(folder: Path) -> Path | None:
    """Compile the peer for Debian's iceoryx. Return None if libiceoryx-posh-dev or libacl1-dev is missing."""
    program = folder / "iceoryx_peer"
    source = Path(__file__).with_name("iceoryx.cpp")
    libraries = [f"-liceoryx_{name}" for name in ("posh_roudi", "posh", "hoofs", "platform")]
    headers = f"-isystem{ICEORYX}"
    command = ["g++", "-O2", "-std=c++17", headers, source, "-o", program, *libraries, "-pthread", "-lrt", "-lacl"]
    return program if subprocess.run(command, capture_output=True, check=False).returncode == 0 else None
