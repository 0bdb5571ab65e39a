"""Turns fastdds_services.cpp into a library of this process, compiled here once against the Fast DDS installed here.

It is kept in the user's cache folder, and loaded from memory, so that no file needs to be believed twice.
"""

from __future__ import annotations

import ctypes
import hashlib
import os
import shlex
import signal
import subprocess
import tempfile
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path

from shmgen.core import cache

_SOURCE = Path(__file__).with_name("fastdds_services.cpp")
_GET = "for those on rmw_fastrtps: sudo apt-get install g++ libfastrtps-dev"
_FLAGS = ("-std=c++17", "-O1", "-fPIC", "-shared", "-w")
_WHICH = """
#if __has_include(<fastdds/config.hpp>)
#include <fastdds/config.hpp>
-lfastdds FASTDDS_VERSION_STR
#elif __has_include(<fastrtps/config.h>)
#include <fastrtps/config.h>
-lfastrtps FASTRTPS_VERSION_STR
#endif
__VERSION__
"""
"""What the preprocessor says of this are the library to link, its version and the compiler's."""
_LOOK = 0.1
_KEPT = 2
"""Libraries of other versions that may stay in the cache folder."""


class Missing(Exception):
    """There is no such library, and the text says what to do."""


def load(tell: Callable[[str], None], ended: Callable[[], bool]) -> ctypes.CDLL:
    """Takes seconds the first time, and ends early once `ended()`. Raises Missing.

    The environment variables of g++ and of the loader say where Fast DDS is, if it is not the system's: CXX, CPATH,
    LIBRARY_PATH, LD_LIBRARY_PATH.
    """
    compiler = shlex.split(os.environ.get("CXX", "")) or ["g++"]
    which = _run([*compiler, "-E", "-P", "-x", "c++", "-"], ended, _WHICH)
    if not which.startswith("-l"):
        raise Missing(f"no Fast DDS is installed; {_GET}")
    sources = [path.read_bytes() for path in (_SOURCE, _SOURCE.with_name("fastdds_versions.hpp"))]
    key = hashlib.sha256(repr((sources, which, compiler, _FLAGS, os.uname().machine)).encode()).hexdigest()
    name = f"fast-services-{key[:32]}"
    library = cache.read(name)
    if library is None:
        tell(f"services of rmw_fastrtps: compiling, once, with Fast DDS {which.split()[1].strip(chr(34))}")
        with tempfile.TemporaryDirectory(prefix="shmgen-") as folder:
            made = os.path.join(folder, "made.so")
            _run([*compiler, *_FLAGS, "-o", made, str(_SOURCE), which.split()[0]], ended)
            library = Path(made).read_bytes()
        cache.write(name, library)
        cache.forget("fast-services-", but=_KEPT)
    return _loaded(library)


def _loaded(library: bytes) -> ctypes.CDLL:
    descriptor = os.memfd_create("shmgen-fast-services")
    try:
        with open(descriptor, "wb", closefd=False) as file:
            file.write(library)
        return ctypes.CDLL(f"/proc/self/fd/{descriptor}")
    except OSError as error:
        raise Missing(f"Fast DDS does not load: {error}") from error
    finally:
        os.close(descriptor)


def _run(command: list[str], ended: Callable[[], bool], text: str = "") -> str:
    """What it says. Raises Missing where it fails, or when this is the end."""
    pipe = subprocess.PIPE
    try:
        process = subprocess.Popen(command, stdin=pipe, stdout=pipe, stderr=pipe, text=True, start_new_session=True)
    except OSError as error:
        raise Missing(f"no C++ compiler, {command[0]}: {error.strerror}; {_GET}") from error
    rest: str | None = text
    while True:
        try:
            said, complained = process.communicate(rest, timeout=_LOOK)
            break
        except subprocess.TimeoutExpired:
            rest = None  # it has that already
            if ended():
                with suppress(ProcessLookupError):
                    os.killpg(process.pid, signal.SIGKILL)  # what it has started too
    if process.returncode:
        why = next((line for line in complained.splitlines() if "error" in line), f"status {process.returncode}")
        raise Missing(f"{command[0]} could not compile it: {why}; {_GET}")
    return said.strip()
