"""Compile services.cpp into a library, against the installed Fast DDS, when hatchling builds the package.

If Fast DDS is not in a system folder, set CXX, CPATH, LIBRARY_PATH and LD_LIBRARY_PATH for the compiler and the loader.
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
INSTALL_HINT = "shmgen-fastdds is compiled against Fast DDS: sudo apt-get install g++ libfastrtps-dev"
LIBRARY_OPTION = """
#if __has_include(<fastdds/config.hpp>)
-lfastdds
#elif __has_include(<fastrtps/config.h>)
-lfastrtps
#endif
"""
"""C source from which the preprocessor prints the linker option of the installed Fast DDS."""


class LibraryHook(BuildHookInterface[Any]):
    """Adds the compiled library to a wheel, or to the source folder for an editable installation."""

    PLUGIN_NAME = "custom"

    def initialize(self, version: str, build_data: dict[str, Any]) -> None:
        """Compile the library. Hatchling calls this before the build. `version` is `standard` or `editable`."""
        sources = Path(self.root) / "shmgen_fastdds"
        if version == "editable":
            compile_library(sources, sources / NAME)
            return
        self._folder = tempfile.TemporaryDirectory()  # kept until the wheel is built
        library = Path(self._folder.name) / NAME
        compile_library(sources, library)
        platform = sysconfig.get_platform().replace("-", "_").replace(".", "_")
        build_data["force_include"][str(library)] = f"shmgen_fastdds/{NAME}"
        build_data["tag"] = f"py3-none-{platform}"
        build_data["pure_python"] = False


def compile_library(sources: Path, target: Path) -> None:
    """Compile services.cpp in `sources` into the library `target`. Raises RuntimeError with instructions on failure."""
    compiler = shlex.split(os.environ.get("CXX", "")) or ["g++"]
    library = run([*compiler, "-E", "-P", "-x", "c++", "-"], LIBRARY_OPTION).strip()
    if not library:
        raise RuntimeError(INSTALL_HINT)
    temporary = target.with_name(f"{NAME}.{os.getpid()}")  # processes that mapped the old library keep it
    try:
        run([*compiler, *FLAGS, "-o", str(temporary), str(sources / "services.cpp"), library])
        temporary.replace(target)
    finally:
        temporary.unlink(missing_ok=True)


def run(command: list[str], text: str = "") -> str:
    """Run a command with `text` as its input and return its output. Raises RuntimeError if it is missing or fails."""
    try:
        return subprocess.run(command, input=text, capture_output=True, text=True, check=True).stdout
    except OSError as error:
        raise RuntimeError(f"no C++ compiler, {command[0]}: {error.strerror}; {INSTALL_HINT}") from error
    except subprocess.CalledProcessError as error:
        reason = next((line for line in error.stderr.splitlines() if "error" in line), f"status {error.returncode}")
        raise RuntimeError(f"{command[0]}: {reason}; {INSTALL_HINT}") from error
