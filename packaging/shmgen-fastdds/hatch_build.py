"""A hook of hatchling: services.cpp becomes a library, against the Fast DDS that is installed here.

g++ and the loader take CXX, CPATH, LIBRARY_PATH and LD_LIBRARY_PATH, which say where it is if it is not the system's.
"""

from __future__ import annotations

import os
import shlex
import subprocess
import sysconfig
import tempfile
from pathlib import Path
from typing import Any

from hatchling.builders.hooks.plugin.interface import BuildHookInterface

NAME = "services.so"
FLAGS = ("-std=c++17", "-O1", "-fPIC", "-shared", "-w")
NEEDS = "shmgen-fastdds is compiled against Fast DDS: sudo apt-get install g++ libfastrtps-dev"
WHICH = """
#if __has_include(<fastdds/config.hpp>)
-lfastdds
#elif __has_include(<fastrtps/config.h>)
-lfastrtps
#endif
"""
"""What the preprocessor says of this is the library to link."""


class LibraryHook(BuildHookInterface[Any]):
    """Adds the library to a wheel, or puts it among the sources for an editable installation."""

    PLUGIN_NAME = "custom"

    def initialize(self, version: str, build_data: dict[str, Any]) -> None:
        """As hatchling calls it before it builds: `version` is `standard` or `editable`."""
        sources = Path(self.root) / "shmgen_fastdds"
        if version == "editable":
            compiled(sources, sources / NAME)
            return
        self._folder = tempfile.TemporaryDirectory()  # until the wheel is made
        made = Path(self._folder.name) / NAME
        compiled(sources, made)
        platform = sysconfig.get_platform().replace("-", "_").replace(".", "_")
        build_data["force_include"][str(made)] = f"shmgen_fastdds/{NAME}"
        build_data["tag"] = f"py3-none-{platform}"
        build_data["pure_python"] = False


def compiled(sources: Path, target: Path) -> None:
    """Raises RuntimeError with what to do."""
    compiler = shlex.split(os.environ.get("CXX", "")) or ["g++"]
    library = run([*compiler, "-E", "-P", "-x", "c++", "-"], WHICH).strip()
    if not library:
        raise RuntimeError(NEEDS)
    made = target.with_name(f"{NAME}.{os.getpid()}")  # whoever has the old one mapped keeps it
    try:
        run([*compiler, *FLAGS, "-o", str(made), str(sources / "services.cpp"), library])
        made.replace(target)
    finally:
        made.unlink(missing_ok=True)


def run(command: list[str], text: str = "") -> str:
    """What it says."""
    try:
        return subprocess.run(command, input=text, capture_output=True, text=True, check=True).stdout
    except OSError as error:
        raise RuntimeError(f"no C++ compiler, {command[0]}: {error.strerror}; {NEEDS}") from error
    except subprocess.CalledProcessError as error:
        why = next((line for line in error.stderr.splitlines() if "error" in line), f"status {error.returncode}")
        raise RuntimeError(f"{command[0]}: {why}; {NEEDS}") from error
