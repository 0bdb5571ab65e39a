"""Helpers for the C++ demos of ROS 2: check the installation, and build a generated package with CMake."""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
from pathlib import Path

from stage import Cell


def needs(package: str) -> None:
    """Raise SystemExit if no ROS 2 with this package is sourced, or if CMake or g++ is missing."""
    prefixes = os.environ.get("AMENT_PREFIX_PATH", "").split(":")
    if not any(Path(prefix, "share", package).is_dir() for prefix in prefixes if prefix):
        sys.exit(f"this example needs a ROS 2 with {package}: source /opt/ros/<distribution>/setup.bash")
    if not shutil.which("cmake") or not shutil.which("g++"):
        sys.exit("this example needs: apt-get install cmake g++")


def build(here: Cell, source: Path) -> Path:
    """Build and install a generated ROS package, and return its folder. The cell's processes then find the package."""
    install, folder = here.folder / "install", here.folder / f"build_{source.name}"
    print(f"\n$ cmake -S {source.name} -B build && cmake --build build --target install", flush=True)
    for command in (
        ["-S", source, "-B", folder, f"-DCMAKE_INSTALL_PREFIX={install}"],
        ["--build", folder, "--target", "install"],
    ):
        done = subprocess.run(["cmake", *map(str, command)], capture_output=True, text=True, check=False)
        if done.returncode:
            sys.exit(done.stdout + done.stderr)
    for name, path in (("AMENT_PREFIX_PATH", install), ("LD_LIBRARY_PATH", install / "lib")):
        here.environment[name] = os.pathsep.join(filter(None, [str(path), here.environment.get(name)]))
    here.environment["ROS_LOG_DIR"] = str(here.folder / "log")
    return install
