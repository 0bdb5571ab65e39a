"""Test the error messages of a failed build of shmgen-fastdds."""

from __future__ import annotations

import importlib.util
from pathlib import Path
from typing import Any

import pytest

from shmgen import __version__

from ..conftest import REPOSITORY

COMPILER = """#!/bin/sh
case "$*" in *-E*) cat "$(dirname "$0")/library"; exit;; esac
echo 'a.hpp:1: fatal error: no such header' >&2
exit 1
"""
PACKAGE = REPOSITORY / "packaging" / "shmgen-fastdds"


@pytest.fixture
def hook() -> Any:
    spec = importlib.util.spec_from_file_location("hatch_build_of_fastdds", PACKAGE / "hatch_build.py")
    assert spec
    assert spec.loader
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


def test_package_version_equals_that_of_shmgen() -> None:
    text = (PACKAGE / "pyproject.toml").read_text()
    assert f'version = "{__version__}"' in text
    assert f'dependencies = ["shmgen=={__version__}"]' in text


def test_build_error_names_the_missing_tool(hook: Any, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    compiler, target = tmp_path / "compiler", tmp_path / "services.so"
    compiler.write_text(COMPILER)
    compiler.chmod(0o755)
    needs = r"sudo apt-get install g\+\+ libfastrtps-dev"
    for compiler_variable, library, reason in (
        ("no-such-compiler", "", "no C\\+\\+ compiler, no-such-compiler: No such file or directory; .*"),
        (str(compiler), "", "shmgen-fastdds is compiled against Fast DDS: "),
        (f"{compiler} -O3", "-lfastrtps", "a.hpp:1: fatal error: no such header; .*"),
    ):
        monkeypatch.setenv("CXX", compiler_variable)
        (tmp_path / "library").write_text(library)
        with pytest.raises(RuntimeError, match=reason + needs):
            hook.compile_library(PACKAGE / "shmgen_fastdds", target)
    assert {file.name for file in tmp_path.iterdir()} == {"compiler", "library"}
