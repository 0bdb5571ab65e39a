"""Prepare the wheels of ROS 2 for builds with CMake. Their CMake files name the machine that built the wheels."""

from __future__ import annotations

import os
import re
import shutil
import subprocess
from pathlib import Path

FOREIGN = re.compile(r'/(opt/python|usr/lib64)/[^;" )]*;?|lttng-ust;')
"""Paths and libraries of the machine that built the wheels."""


def cmake_prefix(wheels: Path, prefix: Path) -> Path:
    """Create `prefix` with repaired copies of the wheels' CMake files and links to all other files. Return `prefix`.

    Omit the messages' code for Python: its generator is slow. Its libraries load only in a Python process. librcl
    requires these libraries but uses nothing of them, so `prefix` has an empty library for each.
    """
    (prefix / "lib").mkdir(parents=True)
    for name in ("bin", "include", "pyvenv.cfg"):
        (prefix / name).symlink_to(wheels / name)
    (prefix / "lib64").symlink_to("lib")
    empty = prefix / "empty.so"
    subprocess.run(["g++", "-shared", "-x", "c++", os.devnull, "-o", empty], check=True)
    for file in (wheels / "lib").iterdir():
        is_for_python = file.name.endswith("__rosidl_generator_py.so")
        (prefix / "lib" / file.name).symlink_to(empty if is_for_python else file)
    shutil.copytree(wheels / "share", prefix / "share", symlinks=True)
    for file in prefix.glob("share/*/cmake/*.cmake"):
        text = file.read_text()
        if (repaired := FOREIGN.sub("", text)) != text:
            file.write_text(repaired)
    (prefix / "share/ament_index/resource_index/rosidl_generator_packages/rosidl_generator_py").unlink()
    return prefix
