"""Compare the output for each folder of tests/cases (definitions and shmgen.toml) with its `expected/`, byte for byte.

layout.lock names every generated file with its SHA-256. If the text of a file exists elsewhere, `expected/` has no copy
of the file. The expected layout.lock then names the place instead of the SHA-256: the copied template, `cases/pose`,
another file of the case, or `generated/`. A change in a header for C therefore changes no file here. In most cases,
layout.lock has only the number of such files in each folder. It has only the SHA-256 of most publishers and
subscribers, and of some messages.
"""

from __future__ import annotations

import os
import re
import shutil
import subprocess
import sys
from collections import Counter
from functools import cache
from pathlib import Path

import pytest

from shmgen import config
from shmgen.core.diagnostics import Report
from shmgen.drift.lockfile import LOCK
from shmgen.generator import pipeline

from .conftest import REPOSITORY
from .support.build import compile_headers, put

CASES = sorted(path for path in (REPOSITORY / "tests" / "cases").iterdir() if path.is_dir())

COPIED = {
    (path.name, path.read_bytes().decode())
    for folder in ("c", "cpp", "cpp_ros", "ros2_control", "st")
    for path in (REPOSITORY / "templates" / folder).iterdir()
    if path.suffix != ".j2"
}

STORED_ELSEWHERE = re.compile(r'^"(.+)/[^/]+" = "(copied from templates|as in cases/pose)"\n', re.MULTILINE)

WITH_NAMES_OF_COPIES = ("everything",)
"""Cases that name each file whose text is stored elsewhere. Other cases only count these files."""

OTHER_TARGETS = ("ros", "ros_cpp", "topics")
"""Cases that generate neither Python nor headers. All other cases generate both."""

each_case = pytest.mark.parametrize("case", CASES, ids=lambda case: case.name)


@each_case
def test_generated_files_are_as_expected(case: Path, update_golden: bool) -> None:
    texts = without_copies(case.name, generate(case))
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


def test_structured_text_is_ascii_with_lf() -> None:
    texts = {path: text for case in CASES for path, text in generate(case).items() if path.endswith(".st")}
    assert len(texts) > 50
    for path, text in texts.items():
        assert text.isascii(), path
        assert "\r" not in text, path
        assert text.endswith("\n"), path


@pytest.mark.parametrize("case", [case for case in CASES if case.name not in OTHER_TARGETS], ids=lambda it: it.name)
@pytest.mark.parametrize("language", ["c", "c++"])
@pytest.mark.family("-everything]", "-hostile]")
def test_headers_compile(case: Path, language: str, tmp_path: Path) -> None:
    put(generate(case), tmp_path)
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
            first, taken = bytes(kind._from_object(message)), foreign(message)
            kind._decode(first, taken)
            assert bytes(message) == first == bytes(kind._from_object(taken)), kind
            print(kind._type_name_)
"""


def test_python_converts_defaults_from_and_to_objects(tmp_path: Path) -> None:
    for case in CASES:
        put({path: text for path, text in generate(case).items() if path.startswith("python/")}, tmp_path)
    done = subprocess.run(
        [sys.executable, "-c", ROUND_TRIP], cwd=tmp_path / "python", capture_output=True, text=True, check=False
    )
    assert done.returncode == 0, done.stderr
    assert {"geometry_msgs/msg/Pose", "demo_msgs/msg/Everything", "demo_msgs/msg/Log"} <= set(done.stdout.split())


@pytest.mark.slow
def test_python_passes_ruff_and_mypy(tmp_path: Path) -> None:
    for case in CASES:
        put({path: text for path, text in generate(case).items() if path.startswith("python/")}, tmp_path)
    packages = sorted((tmp_path / "python").iterdir())
    assert len(packages) == len(CASES) - len(OTHER_TARGETS)
    run_checker("ruff", "check", "--isolated", "--no-cache", str(tmp_path))
    run_checker("mypy", "--strict", "--config-file=", f"--cache-dir={tmp_path}/cache", *map(str, packages))


def generate(case: Path) -> dict[str, str]:
    settings = config.load(case / "shmgen.toml", "shmgen.toml", Report())
    return pipeline.generate(settings, settings.messages)


def without_copies(case: str, texts: dict[str, str]) -> dict[str, str]:
    """Leave out the files whose text is stored elsewhere, and name those places in layout.lock."""
    first = {(Path(path).name, text): path for path, text in reversed(texts.items())}
    places = {
        path: f"as {same}" for path, text in texts.items() if text and (same := first[Path(path).name, text]) != path
    }
    places |= {path: place for path, text in texts.items() if (place := place_of(case, path, text))}
    lock = re.sub(
        r'^"(.+)" = "(\w{64})"$',
        lambda line: f'"{line[1]}" = "{places[line[1]]}"' if line[1] in places else line[0],
        texts[LOCK],
        flags=re.MULTILINE,
    )
    if case not in WITH_NAMES_OF_COPIES:
        lock = with_numbers_of_copies(lock)
    return {key: text for key, text in texts.items() if key not in places and not is_hashed(case, key)} | {LOCK: lock}


def with_numbers_of_copies(lock: str) -> str:
    """Shorten layout.lock: for each folder, replace the lines of files that are stored elsewhere by their number."""
    copies = Counter(STORED_ELSEWHERE.findall(lock))
    lines = (f'"{folder}" = "{number} files {place}"\n' for (folder, place), number in copies.items())
    return STORED_ELSEWHERE.sub("", lock) + "".join(lines)


def is_hashed(case: str, path: str) -> bool:
    """Return True if only the SHA-256 of a file is stored, because another case has the text of a similar file.

    Publishers and subscribers differ only by their names, and the cases pose and everything have some of them. The
    case service has clients and servers, and tests/calls imports its Python.
    """
    if path.endswith(("_shm.h", "_Publisher.st", "_Subscriber.st")):
        return case not in ("pose", "everything")
    if case == "noetic" and ("/srv/" in path or "_Reset" in path):
        return True
    if path.endswith("/__init__.py"):
        return case not in ("pose", "everything", "service")
    if path.startswith("c/") and case in ("empty", "noetic", "reserved", "service"):
        return not path.endswith(("_service.h", "_action.h"))
    return case == "ros_cpp" and "/shm_arm/" in path


def place_of(case: str, path: str, text: str) -> str:
    """Return the place that stores the text of a generated file, or `""` if that is `expected/`."""
    name = path.rpartition("/")[2]
    if (name, text) in COPIED:
        return "copied from templates"
    if path.startswith("plcopen/"):  # a copy of the Structured Text
        return "see generated"
    return "as in cases/pose" if case != "pose" and (name, text) in common_files() else ""


@cache
def common_files() -> set[tuple[str, str]]:
    """Return the name and the text of each file that does not depend on the messages."""
    texts = generate(REPOSITORY / "tests" / "cases" / "pose")
    return {
        (Path(path).name, text) for path, text in texts.items() if path.startswith("st/shmgen/") or "/shmgen.h" in path
    }


def run_checker(*command: str) -> None:
    environment = {**os.environ, "MYPYPATH": str(REPOSITORY / "src")}
    done = subprocess.run(
        [sys.executable, "-m", *command], capture_output=True, text=True, check=False, env=environment
    )
    assert done.returncode == 0, (done.stdout + done.stderr)[-4000:]
