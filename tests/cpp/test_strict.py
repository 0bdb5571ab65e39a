"""Every header, by each compiler and in each language that it is for: the warnings that users turn on are errors."""

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


@pytest.fixture(scope="module")
def headers(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Those of the case that has everything, as C and as C++."""
    folder = tmp_path_factory.mktemp("strict")
    case = REPOSITORY / "tests" / "cases" / "everything" / "shmgen.toml"
    settings = config.load(case, "shmgen.toml", Report())
    put(pipeline.generate(settings, settings.messages), folder)
    return folder


@pytest.mark.parametrize("standard", [*C, *CPP])
@pytest.mark.parametrize("compiler", ["gcc", "clang"])
def test_no_warning(compiler: str, standard: str, headers: Path) -> None:
    if shutil.which(compiler) is None:
        pytest.skip(f"no {compiler}")
    language = "c" if standard in C else "c++"
    if compiler == "gcc" and language == "c++" and shutil.which("g++") is None:
        pytest.skip("no g++: apt-get install g++")
    endings = ["*.h", "*.hpp"] if standard in ("c++17", "c++20") else ["*.h"]
    for ending in endings:
        root = headers / ("c" if ending == "*.h" else "cpp")
        # As a macro of gcc says it: in gnu99 a static assertion is an extension, of which -Wpedantic tells.
        flags = [flag for flag in WARNINGS if standard != "gnu99" or flag != "-Wpedantic"]
        source = "".join(f'#include "{path.relative_to(root)}"\n' for path in sorted(root.rglob(ending)))
        command = [compiler, f"-x{language}", f"-std={standard}", *flags, f"-I{root}", "-fsyntax-only", "-"]
        done = subprocess.run(command, input=source, capture_output=True, text=True, check=False)
        assert done.returncode == 0, done.stderr[:3000]
