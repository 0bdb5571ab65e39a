"""What is kept to save time: whose it must be to count, and how it is turned off."""

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

NOBODY, STRANGER = 65534, 65533
root_only = pytest.mark.skipif(os.geteuid() != 0, reason="needs root, to become somebody else")


@pytest.fixture
def base() -> Iterator[Path]:
    """A folder as XDG_CACHE_HOME that every user reaches."""
    folder = Path(tempfile.mkdtemp(prefix="shmgen-cache-"))
    folder.chmod(0o777)
    yield folder
    shutil.rmtree(folder)


@pytest.fixture(autouse=True)
def folder(base: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.setenv("XDG_CACHE_HOME", str(base))
    monkeypatch.delenv(cache.OFF, raising=False)
    return base / "shmgen"


def as_user(uid: int, work: str) -> str:
    """What some lines of Python print when another user runs them."""
    code = (
        f"import os, sys\nfrom shmgen.core import cache\nos.setgroups([]); os.setgid({uid}); os.setuid({uid})\n{work}"
    )
    return subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True).stdout


def test_what_is_kept_is_found_again(folder: Path) -> None:
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
def test_what_another_might_have_written_does_not_count(folder: Path, spoil: Callable[[Path], object]) -> None:
    cache.write("a", b"kept")
    spoil(folder / "a")
    assert cache.read("a") is None


@root_only
@pytest.mark.parametrize(("whose", "reader"), [(NOBODY, 0), (STRANGER, NOBODY), (0, NOBODY)])
def test_what_belongs_to_another_user_does_not_count(folder: Path, whose: int, reader: int) -> None:
    cache.write("a", b"kept")
    folder.chmod(0o755)
    (folder / "a").chmod(0o644)
    told = "print(cache.read('a'))"
    for path in (folder, folder / "a"):
        os.chown(path, reader, reader)
    assert as_user(reader, told) == "b'kept'\n"
    os.chown(folder / "a", whose, whose)
    assert as_user(reader, told) == "None\n"
    os.chown(folder / "a", reader, reader)
    os.chown(folder, whose, whose)
    assert as_user(reader, told) == "None\n"


@pytest.mark.slow
@root_only
def test_what_another_user_planted_never_counts(base: Path, folder: Path) -> None:
    """Root's own cache, on the other hand, is used: so what was planted would have counted."""
    command = [sys.executable, "-m", "shmgen", "show", "std_msgs/Empty"]
    name = store._cache_name("jazzy")
    content = json.dumps(store.texts("jazzy") | {"std_msgs/msg/Empty": "int8 planted\n"}).encode()
    shutil.rmtree(folder)
    as_user(NOBODY, f"cache.write({name!r}, {content!r})")
    assert folder.stat().st_uid == NOBODY
    assert "planted" not in subprocess.run(command, capture_output=True, text=True, check=True).stdout
    assert [file.name for file in folder.iterdir()] == [name], "root keeps nothing with a stranger"

    shutil.rmtree(folder)
    cache.write(name, content)
    assert "planted" in subprocess.run(command, capture_output=True, text=True, check=True).stdout


@root_only
def test_root_makes_no_folder_in_the_home_of_another(base: Path, folder: Path) -> None:
    home = base / "home"
    home.mkdir()
    os.chown(home, NOBODY, NOBODY)
    os.environ["XDG_CACHE_HOME"] = str(home / "not" / "yet")  # monkeypatch puts it back
    cache.write("a", b"kept")
    assert list(home.iterdir()) == []
    as_user(NOBODY, "cache.write('a', b'kept')")
    assert (home / "not" / "yet" / "shmgen" / "a").stat().st_uid == NOBODY


def test_only_the_newest_are_kept(folder: Path) -> None:
    for number in range(5):
        cache.write(f"x-{number}", b"")
        os.utime(folder / f"x-{number}", ns=(0, time.time_ns() + number))
    cache.write("other", b"")
    cache.forget("x-", 2)
    assert sorted(file.name for file in folder.iterdir()) == ["other", "x-3", "x-4"]


def test_an_entry_that_another_process_removes_meanwhile_is_no_error(folder: Path) -> None:
    """A link to a missing file fails like an entry that vanishes between the listing and its stat()."""
    cache.write("x-0", b"")
    cache.write("x-1", b"")
    (folder / "x-2").symlink_to("missing")
    with warnings.catch_warnings():
        warnings.simplefilter("error")  # a folder that is not closed
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
def test_it_can_be_turned_off(
    folder: Path, tmp_path: Path, command: tuple[str, ...], monkeypatch: pytest.MonkeyPatch
) -> None:
    run(["generate", "std_msgs/Empty"], tmp_path)
    shutil.rmtree(folder)
    time.sleep(0.05)  # what was just written is not remembered as clean
    with_it = run(command, tmp_path)
    doctor = command == ("doctor",)  # whose answer is of the machine's regions, which others make and remove
    assert with_it.code == 0 or doctor
    kept = folder.exists() and {file: file.read_bytes() for file in folder.iterdir()}
    assert kept or doctor
    shutil.rmtree(folder, ignore_errors=True)
    assert run([*command, "--no-cache"], tmp_path) == with_it or doctor
    assert not folder.exists()
    assert cache.OFF not in os.environ
    monkeypatch.setenv(cache.OFF, "1")
    assert run(command, tmp_path) == with_it or doctor
    assert not folder.exists()


@pytest.mark.slow
def test_a_check_without_cache_is_made_in_full(folder: Path, tmp_path: Path) -> None:
    """Not answered from what was remembered, which is told apart here by a word of its own."""
    run(["generate", "std_msgs/Empty"], tmp_path)
    time.sleep(0.05)
    shmgen = [sys.executable, "-m", "shmgen", "check"]

    def said(*more: str, **environment: str) -> str:
        variables = {**os.environ, **environment}
        command = [*shmgen, *more]
        return subprocess.run(command, cwd=tmp_path, env=variables, capture_output=True, text=True, check=True).stdout

    usual = said()
    (kept,) = (file for file in folder.iterdir() if file.name.startswith("clean-"))
    cache.write(kept.name, (cache.read(kept.name) or b"").replace(b"up to date", b"remembered"))
    assert said() == usual.replace("up to date", "remembered")
    assert said("--no-cache") == said(SHMGEN_NO_CACHE="1") == usual
