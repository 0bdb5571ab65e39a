"""Every generated header compiles with each compiler and language standard, with the warnings of users as errors."""

from __future__ import annotations

import shutil
import subprocess
from pathlib import Path

import pytest

from shmgen import config
from shmgen.core.diagnostics import Report
from shmgen.generator import pipeline

from ..conftest import REPOSITORY
from ..support.build import put

C = ("c11", "gnu99", "gnu11")
CPP = ("gnu++11", "c++17", "c++20")
WARNINGS = ["-Wall", "-Wextra", "-Wpedantic", "-Wconversion", "-Wshadow", "-Werror"]
CASTS = {"gcc": ["-Wold-style-cast", "-Wuseless-cast"], "clang": ["-Wold-style-cast"]}
"""Warnings for C++ only."""


@pytest.fixture(scope="module")
def headers(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Generated C and C++ of the case `everything`."""
    folder = tmp_path_factory.mktemp("strict")
    case = REPOSITORY / "tests" / "cases" / "everything" / "shmgen.toml"
    settings = config.load(case, "shmgen.toml", Report())
    put(pipeline.generate(settings, settings.messages), folder)
    return folder


@pytest.mark.parametrize("standard", [*C, *CPP])
@pytest.mark.parametrize("compiler", ["gcc", "clang"])
@pytest.mark.family("gcc-c11", "gcc-c++17")
def test_headers_compile_without_warnings(compiler: str, standard: str, headers: Path) -> None:
    if shutil.which(compiler) is None:
        pytest.skip(f"no {compiler}")
    language = "c" if standard in C else "c++"
    if compiler == "gcc" and language == "c++" and shutil.which("g++") is None:
        pytest.skip("no g++: apt-get install g++")
    endings = ["*.h", "*.hpp"] if standard in ("c++17", "c++20") else ["*.h"]
    for ending in endings:
        root = headers / ("c" if ending == "*.h" else "cpp")
        flags = WARNINGS if language == "c" else [*WARNINGS, *CASTS[compiler]]
        command = [compiler, f"-x{language}", f"-std={standard}", *flags, "-fsyntax-only"]
        compile_all(command, root, ending)


@pytest.mark.slow
@pytest.mark.parametrize("language", ["c", "c++"])
def test_headers_compile_without_warnings_for_thread_sanitizer(language: str, headers: Path) -> None:
    """Keep every function, because gcc warns about fences only in code that it emits."""
    if language == "c++" and shutil.which("g++") is None:
        pytest.skip("no g++: apt-get install g++")
    command = ["gcc", f"-x{language}", "-fsanitize=thread", "-O1", "-fkeep-inline-functions", *WARNINGS]
    compile_all([*command, "-Wno-pedantic", "-c", "-o", "/dev/null"], headers / "c", "*.h")


def compile_all(command: list[str], root: Path, ending: str) -> None:
    """Compile one source file that includes each header below `root`."""
    source = "".join(f'#include "{path.relative_to(root)}"\n' for path in sorted(root.rglob(ending)))
    process = subprocess.run([*command, f"-I{root}", "-"], input=source, capture_output=True, text=True, check=False)
    assert process.returncode == 0, process.stderr[:3000]
