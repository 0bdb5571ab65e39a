"""The built-in store: every message of every distribution reads as rosbags means it, with and without the cache."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import pytest
from rosbags.typesys import Stores, get_typestore

from shmgen.core.diagnostics import Report
from shmgen.core.model import Clock, Scalar, Schema
from shmgen.definitions import Sources, load, open_library, store
from tests.definitions import references

ORIGINAL = {store.value.partition("_")[2]: store for store in Stores if "_" in store.value}


@pytest.fixture(autouse=True)
def cache(monkeypatch, tmp_path):
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))
    return tmp_path / "shmgen"


def everything(source: str) -> Schema:
    sources = Sources((), source)
    return load(sorted({name.package for name in open_library(sources, Report()).known()}), sources, Report())


def test_all_stores_are_offered():
    assert set(store.names()) == set(ORIGINAL)


@pytest.mark.parametrize("source", sorted(ORIGINAL))
def test_every_message_is_what_rosbags_means(source):
    theirs = get_typestore(ORIGINAL[source]).fielddefs
    ours = {str(message.name): message for message in everything(source).messages}
    services = {name for name in ours if name.startswith("std_srvs/")}  # which rosbags leaves out
    assert ours.keys() - services == theirs.keys()
    assert {name.rpartition("_")[0] for name in services} == {
        f"std_srvs/srv/{it}" for it in ("Empty", "SetBool", "Trigger")
    }
    for name in theirs:
        message = ours[name]
        wanted = references.of_typesdict(name, theirs[name], store.dialect(source))
        assert references.without_defaults(references.ours(message)) == wanted, name


def test_what_is_restated():
    schema = load(["geometry_msgs/Quaternion", "std_msgs/Empty", "std_msgs/Header"], Sources(), Report())
    quaternion, empty, header = schema.messages
    assert [field.default for field in quaternion.fields] == [0.0, 0.0, 0.0, 1.0]
    assert empty.fields == ()
    assert (header.fields[0].type, header.fields[0].written) == (Clock.TIME, "builtin_interfaces/Time")
    assert quaternion.span.path == "jazzy:geometry_msgs/msg/Quaternion.msg"
    assert quaternion.origin == "built-in store jazzy"
    assert "float64 w 1\n" in quaternion.text


def test_noetic_is_ros1():
    schema = load(
        ["geometry_msgs/Quaternion", "std_msgs/Byte", "std_msgs/Time", "bond/Constants"],
        Sources((), "noetic"),
        Report(),
    )
    found = {message.name.name: message for message in schema.messages}
    assert [field.default for field in found["Quaternion"].fields] == [None] * 4
    assert found["Byte"].fields[0].type is Scalar.INT8
    assert (found["Time"].fields[0].type, found["Time"].fields[0].written) == (Clock.TIME, "time")
    constants = {constant.name: constant.value for constant in found["Constants"].constants}
    assert constants["DISABLE_HEARTBEAT_TIMEOUT_PARAM"] == "/bond_disable_heartbeat_timeout"


def test_the_cache_gives_the_same_and_is_made_once(cache):
    first = everything("jazzy")
    (file,) = cache.iterdir()
    before = file.stat().st_mtime_ns
    assert everything("jazzy") == first
    assert file.stat().st_mtime_ns == before


@pytest.mark.parametrize(
    "damage",
    [
        lambda whole: b"",
        lambda whole: b"\xff\xfe\n[]",
        lambda whole: b"00000000\n{}",
        lambda whole: whole[:-100],
        lambda whole: whole.replace(b"float64", b"float32", 1),
    ],
    ids=["empty", "junk", "another", "cut", "altered"],
)
def test_a_damaged_cache_is_replaced(cache, damage):
    first = everything("jazzy")
    (file,) = cache.iterdir()
    whole = file.read_bytes()
    file.write_bytes(damage(whole))
    assert everything("jazzy") == first
    assert file.read_bytes() == whole
    assert list(cache.iterdir()) == [file]


def test_a_cache_that_cannot_be_written_is_done_without(cache):
    first = everything("jazzy")
    (file,) = cache.iterdir()
    file.unlink()
    cache.rmdir()
    cache.write_text("a file where the folder should be")
    assert everything("jazzy") == first
    assert cache.read_text() == "a file where the folder should be"


def loaded_by(*requests: str, path: str = "") -> str:
    """Which of the slow modules a run that reads `requests` loads."""
    code = (
        "import sys; from pathlib import Path\n"
        "from shmgen.definitions import *; from shmgen.core.diagnostics import Report\n"
        f"load({requests!r}, Sources(({f'Path({path!r}),' if path else ''})), Report())\n"
        "print(*(name for name in ('rosbags', 'importlib.metadata', 'xml') if name in sys.modules))"
    )
    return subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True).stdout.strip()


def test_rosbags_is_loaded_only_to_fill_the_cache(tmp_path):
    assert loaded_by("geometry_msgs/Pose") == "rosbags"
    assert loaded_by("geometry_msgs/Pose") == ""


def test_a_folder_that_answers_all_needs_no_store(tmp_path):
    folder = tmp_path / "x_msgs" / "msg"
    folder.mkdir(parents=True)
    (folder / "A.msg").write_text("int8 a\nbuiltin_interfaces/Time stamp")
    assert loaded_by("x_msgs/A", path=str(tmp_path)) == ""
    assert not Path(os.environ["XDG_CACHE_HOME"], "shmgen").exists()


def test_without_a_home_nothing_is_left_behind(tmp_path, monkeypatch):
    monkeypatch.setenv("HOME", "")
    monkeypatch.setenv("XDG_CACHE_HOME", "relative")
    monkeypatch.chdir(tmp_path)
    assert everything("humble").messages
    assert list(tmp_path.iterdir()) == []
