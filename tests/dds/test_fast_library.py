"""The bridge's library of Fast DDS: compiled once, kept where nobody else can write, and what is said without it."""

from __future__ import annotations

import shutil
from pathlib import Path

import pytest

from shmgen.bridge.dds import fastdds_library
from shmgen.bridge.dds.fastdds_library import Missing

# Says which Fast DDS there is, and makes a library of nothing.
COMPILER = """#!/bin/sh
cd "$(dirname "$0")"
case "$*" in *-E*) cat version; exit;; esac
echo "$*" >> compiled
test -s wrong && { cat wrong >&2; exit 1; }
while [ "$1" != -o ]; do shift; done
exec cc -shared -o "$2" -x c /dev/null
"""
VERSION = '-lfastrtps "2.9.1"\n"12.2.0"\n'


@pytest.fixture
def compiler(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    if not shutil.which("cc"):
        pytest.skip("no compiler")
    script = tmp_path / "compiler"
    script.write_text(COMPILER)
    script.chmod(0o755)
    (tmp_path / "version").write_text(VERSION)
    (tmp_path / "compiled").touch()
    monkeypatch.setenv("CXX", f"{script} -O3")
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "cache"))
    monkeypatch.delenv("SHMGEN_NO_CACHE", raising=False)
    return tmp_path


def loads(folder: Path) -> int:
    """How often it has been compiled, after one more start."""
    fastdds_library.load(lambda line: None, lambda: False)
    return len((folder / "compiled").read_text().splitlines())


def test_it_is_compiled_once(compiler: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """And again for another Fast DDS, where nothing may be kept, and where others may write."""
    told: list[str] = []
    fastdds_library.load(told.append, lambda: False)
    assert told == ["services of rmw_fastrtps: compiling, once, with Fast DDS 2.9.1"]
    assert loads(compiler) == loads(compiler) == 1
    (compiler / "version").write_text(VERSION.replace("9.1", "9.2"))
    assert loads(compiler) == loads(compiler) == 2
    for kept in (compiler / "cache" / "shmgen").iterdir():
        kept.chmod(0o620)
    assert loads(compiler) == 3
    monkeypatch.setenv("SHMGEN_NO_CACHE", "1")
    assert loads(compiler) == 4
    assert "-O3" in (compiler / "compiled").read_text()


def test_what_is_missing_is_named(compiler: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (compiler / "wrong").write_text("a.hpp:1: fatal error: no such header\n")
    with pytest.raises(Missing, match=r"could not compile it: a.hpp:1: fatal error: no such header; .*apt-get install"):
        loads(compiler)
    (compiler / "version").write_text('"12.2.0"\n')
    with pytest.raises(Missing, match=r"no Fast DDS is installed; .*sudo apt-get install g\+\+ libfastrtps-dev"):
        loads(compiler)
    monkeypatch.setenv("CXX", "")
    monkeypatch.setenv("PATH", str(compiler))
    with pytest.raises(Missing, match=r"no C\+\+ compiler, g\+\+: No such file or directory; .*sudo apt-get install"):
        loads(compiler)
