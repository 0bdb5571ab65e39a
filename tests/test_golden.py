"""Each folder of tests/cases: definitions, their shmgen.toml, and byte for byte what is generated from them."""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
from fnmatch import fnmatch
from pathlib import Path

import pytest

from shmgen import config
from shmgen.core.diagnostics import Report
from shmgen.generator import pipeline

from .conftest import REPOSITORY
from .support.build import compile_headers, put

CASES = sorted(path for path in (REPOSITORY / "tests" / "cases").iterdir() if path.is_dir())

each_case = pytest.mark.parametrize("case", CASES, ids=lambda case: case.name)


@each_case
def test_generated_is_as_expected(case: Path, update_golden: bool) -> None:
    texts = {path: text for path, text in generated(case).items() if case.name == "pose" or not is_common(path)}
    expected = case / "expected"
    if update_golden:
        shutil.rmtree(expected, ignore_errors=True)
        put(texts, expected)
    files = {
        str(path.relative_to(expected)): path
        for path in expected.rglob("*")
        if path.is_file() and path.parent.name != "__pycache__"
    }
    assert sorted(files) == sorted(texts)
    for path, text in texts.items():
        assert files[path].read_bytes().decode() == text, f"{case.name}: {path}"


@each_case
def test_structured_text_is_ascii_with_lf(case: Path) -> None:
    texts = {path: text for path, text in generated(case).items() if path.endswith(".st")}
    assert texts
    for path, text in texts.items():
        assert text.isascii(), path
        assert "\r" not in text, path
        assert text.endswith("\n"), path


@each_case
@pytest.mark.parametrize("language", ["c", "c++"])
def test_headers_compile(case: Path, language: str, tmp_path: Path) -> None:
    put(generated(case), tmp_path)
    compile_headers(tmp_path, language)


ROUND_TRIP = """
import importlib, pathlib, types
from shmgen import runtime

def foreign(value):
    if isinstance(value, runtime.Message):
        return types.SimpleNamespace(**{name: foreign(getattr(value, name)) for name in value._names_})
    if hasattr(value, "nanosec"):
        return types.SimpleNamespace(sec=value.sec, nanosec=value.nanosec)
    return value if isinstance(value, (str, bool, int, float)) else list(value)

for path in sorted(pathlib.Path.cwd().glob("*/*/*/_*.py")):
    module = importlib.import_module(".".join(path.relative_to(pathlib.Path.cwd()).with_suffix("").parts))
    for kind in vars(module).values():
        if isinstance(kind, type) and issubclass(kind, runtime.Message) and kind.__module__ == module.__name__:
            message = kind()
            first, second = bytearray(bytes(message)), bytearray(bytes(message))
            kind._encode(message, first, 0, [])
            taken = foreign(message)
            kind._decode(bytes(first), 0, taken)
            kind._encode(taken, second, 0, [])
            assert bytes(message) == first == second, kind
            print(kind._type_name_)
"""


def test_python_carries_the_defaults_to_and_fro(tmp_path: Path) -> None:
    for case in CASES:
        put({path: text for path, text in generated(case).items() if path.startswith("python/")}, tmp_path)
    done = subprocess.run(
        [sys.executable, "-c", ROUND_TRIP], cwd=tmp_path / "python", capture_output=True, text=True, check=False
    )
    assert done.returncode == 0, done.stderr
    assert {"geometry_msgs/msg/Pose", "demo_msgs/msg/Everything", "demo_msgs/msg/Log"} <= set(done.stdout.split())


def test_python_passes_ruff_and_mypy(tmp_path: Path) -> None:
    for case in CASES:
        put({path: text for path, text in generated(case).items() if path.startswith("python/")}, tmp_path)
    packages = sorted((tmp_path / "python").iterdir())
    assert len(packages) == len(CASES)
    checked("ruff", "check", "--isolated", "--no-cache", str(tmp_path))
    checked("mypy", "--strict", "--config-file=", f"--cache-dir={tmp_path}/cache", *map(str, packages))


def generated(case: Path) -> dict[str, str]:
    settings = config.load(case / "shmgen.toml", "shmgen.toml", Report())
    return pipeline.generate(settings, settings.messages)


def is_common(path: str) -> bool:
    """Or holds what is: the XML has all of the Structured Text once more."""
    if path.startswith(("c/", "cpp/", "ros2_cpp/", "ros2_control/")):
        return fnmatch(path, "*/shmgen_*.h*") or path.endswith("/shmgen.hpp")
    return path.startswith(("st/shmgen/", "plcopen/")) and "ST_shmgen_Time" not in path


def checked(*command: str) -> None:
    environment = {**os.environ, "MYPYPATH": str(REPOSITORY / "src")}
    done = subprocess.run(
        [sys.executable, "-m", *command], capture_output=True, text=True, check=False, env=environment
    )
    assert done.returncode == 0, (done.stdout + done.stderr)[-4000:]
