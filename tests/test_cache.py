"""The cache uses only files of its own user, and an option or a variable disables it."""

from __future__ import annotations

import json
import os
import shutil
import subprocess
import sys
import tempfile
import time
import warnings
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest

from shmgen.core import cache
from shmgen.definitions import store

from .support.command import run

NOBODY, OTHER = 65534, 65533
root_only = pytest.mark.skipif(os.geteuid() != 0, reason="needs root, to become another user")


@pytest.fixture
def base() -> Iterator[Path]:
    """A folder for XDG_CACHE_HOME that every user can write to."""
    folder = Path(tempfile.mkdtemp(prefix="shmgen-cache-"))
    folder.chmod(0o777)
    yield folder
    shutil.rmtree(folder)


@pytest.fixture(autouse=True)
def folder(base: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.setenv("XDG_CACHE_HOME", str(base))
    monkeypatch.delenv(cache.OFF, raising=False)
    return base / "shmgen"


def run_as_user(uid: int, work: str) -> str:
    """Execute lines of Python as another user. Return their output."""
    code = (
        f"import os, sys\nfrom shmgen.core import cache\nos.setgroups([]); os.setgid({uid}); os.setuid({uid})\n{work}"
    )
    return subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True).stdout


def test_cache_returns_the_written_entry(folder: Path) -> None:
    assert cache.read("a") is None
    cache.write("a", b"one\ntwo\0")
    assert cache.read("a") == b"one\ntwo\0"
    assert [file.name for file in folder.iterdir()] == ["a"]
    assert (folder.stat().st_mode & 0o777, (folder / "a").stat().st_mode & 0o777) == (0o700, 0o600)


@pytest.mark.parametrize(
    "spoil",
    [
        lambda file: file.write_bytes(file.read_bytes()[:-1]),
        lambda file: file.write_bytes(b"no checksum"),
        lambda file: file.chmod(0o620),
        lambda file: file.chmod(0o602),
        lambda file: file.parent.chmod(0o770),
        lambda file: file.parent.chmod(0o1777),
        lambda file: file.rename(file.with_name("other")) and file.symlink_to("other"),
        lambda file: file.parent.rename(file.parents[1] / "other") and file.parent.symlink_to("other"),
        lambda file: (file.unlink(), os.mkfifo(file)),
        lambda file: (file.unlink(), file.mkdir()),
    ],
    ids=["cut", "junk", "group", "others", "folder-group", "folder-others", "link", "folder-link", "fifo", "folder"],
)
def test_cache_ignores_files_that_others_could_write(folder: Path, spoil: Callable[[Path], object]) -> None:
    cache.write("a", b"kept")
    spoil(folder / "a")
    assert cache.read("a") is None


@root_only
@pytest.mark.parametrize(("owner", "reader"), [(NOBODY, 0), (OTHER, NOBODY), (0, NOBODY)])
def test_cache_ignores_files_of_another_user(folder: Path, owner: int, reader: int) -> None:
    cache.write("a", b"kept")
    folder.chmod(0o755)
    (folder / "a").chmod(0o644)
    read_entry = "print(cache.read('a'))"
    for path in (folder, folder / "a"):
        os.chown(path, reader, reader)
    assert run_as_user(reader, read_entry) == "b'kept'\n"
    os.chown(folder / "a", owner, owner)
    assert run_as_user(reader, read_entry) == "None\n"
    os.chown(folder / "a", reader, reader)
    os.chown(folder, owner, owner)
    assert run_as_user(reader, read_entry) == "None\n"


@pytest.mark.slow
@root_only
def test_root_ignores_a_cache_of_another_user(base: Path, folder: Path) -> None:
    """Read the same content from root's own cache, which proves that the content would have had an effect."""
    command = [sys.executable, "-m", "shmgen", "show", "std_msgs/Empty"]
    name = store._cache_name("jazzy")
    content = json.dumps(store.texts("jazzy") | {"std_msgs/msg/Empty": "int8 planted\n"}).encode()
    shutil.rmtree(folder)
    run_as_user(NOBODY, f"cache.write({name!r}, {content!r})")
    assert folder.stat().st_uid == NOBODY
    assert "planted" not in subprocess.run(command, capture_output=True, text=True, check=True).stdout
    assert [file.name for file in folder.iterdir()] == [name], "root writes nothing into a folder of another user"

    shutil.rmtree(folder)
    cache.write(name, content)
    assert "planted" in subprocess.run(command, capture_output=True, text=True, check=True).stdout


@root_only
def test_root_creates_no_cache_in_the_home_of_another_user(base: Path, folder: Path) -> None:
    home = base / "home"
    home.mkdir()
    os.chown(home, NOBODY, NOBODY)
    os.environ["XDG_CACHE_HOME"] = str(home / "not" / "yet")  # monkeypatch restores the variable
    cache.write("a", b"kept")
    assert list(home.iterdir()) == []
    run_as_user(NOBODY, "cache.write('a', b'kept')")
    assert (home / "not" / "yet" / "shmgen" / "a").stat().st_uid == NOBODY


def test_forget_keeps_the_newest_entries(folder: Path) -> None:
    for number in range(5):
        cache.write(f"x-{number}", b"")
        os.utime(folder / f"x-{number}", ns=(0, time.time_ns() + number))
    cache.write("other", b"")
    cache.forget("x-", 2)
    assert sorted(file.name for file in folder.iterdir()) == ["other", "x-3", "x-4"]


def test_forget_accepts_an_entry_that_vanishes(folder: Path) -> None:
    """Use a link to a missing file: its stat() fails as for an entry that vanished after the listing."""
    cache.write("x-0", b"")
    cache.write("x-1", b"")
    (folder / "x-2").symlink_to("missing")
    with warnings.catch_warnings():
        warnings.simplefilter("error")  # a ResourceWarning for an unclosed folder is an error
        cache.forget("x-", 2)
    assert len(list(folder.iterdir())) == 2


COMMANDS = (
    ("generate", "std_msgs/Empty"),
    ("check",),
    ("show", "std_msgs/Empty", "--svg"),
    ("list", "std_msgs"),
    ("doctor",),
)


@pytest.mark.parametrize("command", COMMANDS, ids=lambda command: command[0])
def test_option_and_variable_disable_the_cache(
    folder: Path, tmp_path: Path, command: tuple[str, ...], monkeypatch: pytest.MonkeyPatch
) -> None:
    run(["generate", "std_msgs/Empty"], tmp_path)
    shutil.rmtree(folder)
    time.sleep(0.05)  # the cache records no result for files that were just written
    with_cache = run(command, tmp_path)
    doctor = command == ("doctor",)  # its output depends on regions of other processes
    assert with_cache.code == 0 or doctor
    entries = folder.exists() and {file: file.read_bytes() for file in folder.iterdir()}
    assert entries or doctor
    shutil.rmtree(folder, ignore_errors=True)
    assert run([*command, "--no-cache"], tmp_path) == with_cache or doctor
    assert not folder.exists()
    assert cache.OFF not in os.environ
    monkeypatch.setenv(cache.OFF, "1")
    assert run(command, tmp_path) == with_cache or doctor
    assert not folder.exists()


@pytest.mark.slow
def test_check_without_cache_compares_all_files(folder: Path, tmp_path: Path) -> None:
    """Replace a word of the cached answer. Only a check with the cache prints the new word."""
    run(["generate", "std_msgs/Empty"], tmp_path)
    time.sleep(0.05)
    shmgen = [sys.executable, "-m", "shmgen", "check"]

    def check_output(*more: str, **environment: str) -> str:
        variables = {**os.environ, **environment}
        command = [*shmgen, *more]
        return subprocess.run(command, cwd=tmp_path, env=variables, capture_output=True, text=True, check=True).stdout

    usual = check_output()
    (entry,) = (file for file in folder.iterdir() if file.name.startswith("clean-"))
    cache.write(entry.name, (cache.read(entry.name) or b"").replace(b"up to date", b"remembered"))
    assert check_output() == usual.replace("up to date", "remembered")
    assert check_output("--no-cache") == check_output(SHMGEN_NO_CACHE="1") == usual
