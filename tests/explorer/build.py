"""Compiles the explorer with generated files: C headers unchanged, Structured Text translated to C++."""

from __future__ import annotations

import functools
import json
import os
import shutil
import subprocess
from collections.abc import Mapping
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Any

from shmgen.config import Config
from shmgen.core.model import Regions
from shmgen.generator import pipeline
from tests.softplc.translate import translate
from tests.support import kept

HERE = Path(__file__).parent
PACKAGE = "shm_ex"
DEFINITIONS = {
    "ex_msgs/msg/Pair.msg": "uint64 a\nuint64 b\n",
    "ex_msgs/srv/Ask.srv": "uint64 a\nuint64 b\n---\nuint64 a\nuint64 b\n",
}
_SOFTPLC = HERE.parent / "softplc"
_CORE = ("search.c", "actors.c", "memory.c", "files.c", "system.c", "checks.c")
"""The explorer itself. All other sources are endpoints, in which the compiler calls memory.c for each access."""
_ENDPOINTS = ("endpoints.c", "calls.c", "litmus.c")
_RENAMED = [f"-D{name}=explored_{name}" for name in ("memcpy", "calloc", "free")]
_STEPS = ("-O1", "-fsanitize=thread", "-Wno-tsan", "-DSHMGEN_LOOKS_FIRST=1")
"""With the thread sanitizer, the headers switch SHMGEN_LOOKS_FIRST off; this switches it on, as shipped."""
_C = ("gcc", "-std=gnu11", "-g", "-Wall", "-Wextra", "-Wno-unused-parameter", "-Werror")
_CPP = ("g++", "-std=gnu++17", "-g", "-w", "-fno-gnu-unique")
TOOLS = ("gcc", "g++")


def missing() -> list[str]:
    """Return the tools that this machine lacks, and "x86-64" on another machine, because the coroutines need it."""
    machine = [] if os.uname().machine == "x86_64" else ["x86-64"]
    return [tool for tool in TOOLS if shutil.which(tool) is None] + machine


def generate(folder: Path, sync: str = "lock") -> dict[str, str]:
    """Generate the files for the explorer's messages. Return their texts by path."""
    for path, text in DEFINITIONS.items():
        file = folder / "definitions" / path
        file.parent.mkdir(parents=True, exist_ok=True)
        file.write_text(text)
    config = Config(
        folder,
        path=(folder / "definitions",),
        package=PACKAGE,
        regions=Regions(sync=sync),  # type: ignore[arg-type]
        targets=("c", "st"),
    )
    return pipeline.generate(config, ["ex_msgs"])


def replace_files(texts: Mapping[str, str], folder: Path) -> dict[str, str]:
    """Return `texts`, with files of the same name in `folder` in place of the generated files."""
    replacements = {path.name: path.read_text() for path in folder.rglob("*") if path.suffix in (".h", ".st")}
    assert replacements.keys() <= {Path(path).name for path in texts}, f"{folder} contains files that are not generated"
    return {path: replacements.get(Path(path).name, text) for path, text in texts.items()}


def build(folder: Path, texts: Mapping[str, str]) -> Path:
    """Compile the explorer with these files in `folder`, and return the path of the program.

    The program is cached, as in tests/softplc.
    """
    program = folder / "explore"
    headers = folder / "c"
    for path, text in texts.items():
        file = folder / path
        file.parent.mkdir(parents=True, exist_ok=True)
        file.write_text(text)
    unit = "\n".join(translate({path: text for path, text in texts.items() if path.endswith(".st")}).units)
    (folder / "plc.hpp").write_text(unit)
    includes = [f"-I{path}" for path in (HERE, headers, headers / PACKAGE, _SOFTPLC)]
    c = {name: text for name, text in texts.items() if name.endswith(".h")}
    jobs = [(HERE / name, [*_C, "-O2", *includes], c if name == "files.c" else {}) for name in _CORE]
    jobs += [(HERE / name, [*_C, *_STEPS, *_RENAMED, *includes], c) for name in _ENDPOINTS]
    jobs += [(HERE / "plc.cpp", [*_CPP, *_STEPS, *includes, "-include", str(folder / "plc.hpp")], {"plc.hpp": unit})]
    jobs += [(_SOFTPLC / "shim.c", [*_C, "-O1", "-w", *includes], {})]
    with ThreadPoolExecutor(os.cpu_count()) as pool:
        objects = list(pool.map(lambda job: _object(folder, *job), jobs))
    _call(["g++", "-o", str(program), *map(str, objects)])
    return program


def explore(program: Path, arguments: list[str], seconds: float) -> tuple[dict[str, Any], str]:
    """Run the explorer. Return its result, and the steps of the schedule that it found."""
    command = ["nice", "-n", "5", str(program), f"seconds={seconds}", *arguments]
    process = subprocess.run(command, capture_output=True, text=True, timeout=3 * seconds + 60, check=False)
    assert process.returncode == 0, f"{' '.join(command)}: {process.stderr}"
    verdict, _, steps = process.stdout.rpartition('{"found"')[2].partition("\n")
    text = process.stdout.partition('{"found"')[0] + steps
    return json.loads('{"found"' + verdict), text


def _object(folder: Path, source: Path, command: list[str], texts: Mapping[str, str]) -> Path:
    object_file = folder / f"{source.stem}.o"
    options = [part.replace(str(folder), "") for part in command]
    name = f"explorer-{kept.key(_key(), source.read_text(), *options, *(x for item in texts.items() for x in item))}"
    kept.find_or_create(name, object_file, lambda: _call([*command, "-c", str(source), "-o", str(object_file)]))
    return object_file


@functools.cache
def _key() -> str:
    compiler = subprocess.run(["g++", "--version"], capture_output=True, check=True).stdout
    return kept.key(compiler, *(path.read_bytes() for path in sorted((*HERE.glob("*.h"), *_SOFTPLC.glob("*.h*")))))


def _call(command: list[str]) -> None:
    process = subprocess.run(command, capture_output=True, text=True, check=False)
    assert process.returncode == 0, f"{' '.join(command)}: {process.stderr[:6000]}"
