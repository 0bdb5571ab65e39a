"""Compiles Structured Text into a shared library, with C++ and g++ as intermediate steps, and loads the library."""

from __future__ import annotations

import functools
import os
import pickle
import subprocess
import tempfile
from collections.abc import Mapping
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

from tests.softplc.plc import Plc
from tests.softplc.reading import CompileError
from tests.softplc.translate import Translation, translate
from tests.support import kept

_HERE = Path(__file__).parent
_FLAGS = ("-O0", "-Wall", "-Werror", "-fPIC", f"-I{_HERE}")
# g++ makes inline variables unique in the process; two PLCs must not share their lists of constants.
_CPP = ("g++", "-std=gnu++17", "-fno-gnu-unique", "-Wno-invalid-offsetof", "-Wno-address-of-packed-member")


def compile_st(files: Mapping[str, str], folder: Path | None = None) -> Plc:
    """Compile the files of a PLC and return the PLC, ready to run. `files` maps each path to its text.

    A file contains one or more objects. The stem of a path is the name of a variable list, as in the IDEs; all other
    objects contain their names. `folder` is the folder in which the library stays for other processes (see task.py).
    Raises Unsupported if the translator does not support a construct, and CompileError for an undeclared name or a
    wrong type, for example.
    """
    translation = translate(files)
    if folder is not None:
        return Plc.load(_library(translation, folder))
    with tempfile.TemporaryDirectory(prefix="softplc") as temporary:
        return Plc.load(_library(translation, Path(temporary)))


def _library(program: Translation, folder: Path) -> Path:
    folder.mkdir(parents=True, exist_ok=True)
    library = folder / "plc.so"
    library.with_suffix(".pickle").write_bytes(pickle.dumps((program.types, program.enumerations, len(program.units))))
    name = f"plc-{kept.key(_compiler_key(), *program.units)}"
    kept.find_or_create(name, library, lambda: _compile(program, folder, library))
    return library


def _compile(translation: Translation, folder: Path, library: Path) -> None:
    jobs = [["gcc", "-std=gnu11", *_FLAGS, "-c", str(_HERE / "shim.c"), "-o", str(folder / "shim.o")]]
    for number, unit in enumerate(translation.units):
        source = folder / f"unit{number}.cpp"
        source.write_text(unit)
        jobs.append([*_CPP, *_FLAGS, "-c", str(source), "-o", str(source.with_suffix(".o"))])
    with ThreadPoolExecutor(os.cpu_count()) as pool:
        list(pool.map(_run, jobs))
    _run(["g++", "-shared", "-Wl,-Bsymbolic", "-o", str(library), *(job[-1] for job in jobs), "-pthread", "-lrt"])


@functools.cache
def _compiler_key() -> str:
    """Return a key for the compiler, its options and the run-time files. Programs with another key are recompiled."""
    compiler = subprocess.run([*_CPP, "--version"], capture_output=True, check=True).stdout
    ours = sorted(path.read_bytes() for path in (*_HERE.glob("shim.*"), *_HERE.glob("*.hpp")))
    return kept.key(compiler, *_CPP, *_FLAGS, *ours)


def _run(command: list[str]) -> None:
    done = subprocess.run(command, capture_output=True, text=True)
    if done.returncode:
        raise CompileError(done.stderr[:6000])
