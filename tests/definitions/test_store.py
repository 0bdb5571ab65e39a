"""Test the built-in store: the messages of all distributions match rosbags, with and without the cache."""

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


def load_all(source: str) -> Schema:
    library = open_library(Sources((), source), Report())
    return load(library, sorted({name.package for name in library.known()}), Report())


def test_all_stores_are_available():
    assert set(store.names()) == set(ORIGINAL)


@pytest.mark.parametrize("source", sorted(ORIGINAL))
def test_messages_match_rosbags(source):
    reference = get_typestore(ORIGINAL[source]).fielddefs
    messages = {str(message.name): message for message in load_all(source).messages}
    services = {name for name in messages if name.startswith("std_srvs/")}  # rosbags omits them
    assert messages.keys() - services == reference.keys()
    assert {name.rpartition("_")[0] for name in services} == {
        f"std_srvs/srv/{service}" for service in ("Empty", "SetBool", "Trigger")
    }
    for name in reference:
        message = messages[name]
        expected = references.from_rosbags(name, reference[name], store.dialect(source))
        assert references.without_defaults(references.from_shmgen(message)) == expected, name


def test_definitions_are_restored_with_defaults():
    requests = ["geometry_msgs/Quaternion", "std_msgs/Empty", "std_msgs/Header"]
    schema = load(open_library(Sources(), Report()), requests, Report())
    quaternion, empty, header = schema.messages
    assert [field.default for field in quaternion.fields] == [0.0, 0.0, 0.0, 1.0]
    assert empty.fields == ()
    assert (header.fields[0].type, header.fields[0].written) == (Clock.TIME, "builtin_interfaces/Time")
    assert quaternion.span.path == "jazzy:geometry_msgs/msg/Quaternion.msg"
    assert quaternion.origin == "built-in store jazzy"
    assert "float64 w 1\n" in quaternion.text


def test_noetic_uses_the_dialect_of_ros1():
    requests = ["geometry_msgs/Quaternion", "std_msgs/Byte", "std_msgs/Time", "bond/Constants"]
    schema = load(open_library(Sources((), "noetic"), Report()), requests, Report())
    messages = {message.name.name: message for message in schema.messages}
    assert [field.default for field in messages["Quaternion"].fields] == [None] * 4
    assert messages["Byte"].fields[0].type is Scalar.INT8
    assert (messages["Time"].fields[0].type, messages["Time"].fields[0].written) == (Clock.TIME, "time")
    constants = {constant.name: constant.value for constant in messages["Constants"].constants}
    assert constants["DISABLE_HEARTBEAT_TIMEOUT_PARAM"] == "/bond_disable_heartbeat_timeout"


def test_cache_is_written_once_and_returns_the_same(cache):
    first = load_all("jazzy")
    (file,) = cache.iterdir()
    before = file.stat().st_mtime_ns
    assert load_all("jazzy") == first
    assert file.stat().st_mtime_ns == before


@pytest.mark.parametrize(
    "damage",
    [
        lambda content: b"",
        lambda content: b"\xff\xfe\n[]",
        lambda content: b"00000000\n{}",
        lambda content: content[:-100],
        lambda content: content.replace(b"float64", b"float32", 1),
    ],
    ids=["empty", "junk", "another", "cut", "altered"],
)
def test_damaged_cache_is_replaced(cache, damage):
    first = load_all("jazzy")
    (file,) = cache.iterdir()
    content = file.read_bytes()
    file.write_bytes(damage(content))
    assert load_all("jazzy") == first
    assert file.read_bytes() == content
    assert list(cache.iterdir()) == [file]


def test_store_works_without_a_writable_cache(cache):
    first = load_all("jazzy")
    (file,) = cache.iterdir()
    file.unlink()
    cache.rmdir()
    cache.write_text("a file where the folder should be")
    assert load_all("jazzy") == first
    assert cache.read_text() == "a file where the folder should be"


def loaded_modules(*requests: str, path: str = "") -> str:
    """Return the slow modules that are loaded to read `requests`."""
    code = (
        "import sys; from pathlib import Path\n"
        "from shmgen.definitions import *; from shmgen.core.diagnostics import Report\n"
        f"load(open_library(Sources(({f'Path({path!r}),' if path else ''})), Report()), {requests!r}, Report())\n"
        "print(*(name for name in ('rosbags', 'importlib.metadata', 'xml') if name in sys.modules))"
    )
    return subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True).stdout.strip()


def test_rosbags_is_loaded_only_to_fill_the_cache(tmp_path):
    assert loaded_modules("geometry_msgs/Pose") == "rosbags"
    assert loaded_modules("geometry_msgs/Pose") == ""


def test_complete_folder_needs_no_store(tmp_path):
    folder = tmp_path / "x_msgs" / "msg"
    folder.mkdir(parents=True)
    (folder / "A.msg").write_text("int8 a\nbuiltin_interfaces/Time stamp")
    assert loaded_modules("x_msgs/A", path=str(tmp_path)) == ""
    assert not Path(os.environ["XDG_CACHE_HOME"], "shmgen").exists()


def test_no_cache_is_written_without_a_home(tmp_path, monkeypatch):
    monkeypatch.setenv("HOME", "")
    monkeypatch.setenv("XDG_CACHE_HOME", "relative")
    monkeypatch.chdir(tmp_path)
    assert load_all("humble").messages
    assert list(tmp_path.iterdir()) == []
