"""Tests of tools with hostile files in /dev/shm: no regions, impossible headers, terminal escape sequences."""

from __future__ import annotations

import json
import os
import shutil
import struct
import subprocess
import sys

import pytest

from shmgen.runtime import region_name
from shmgen.runtime.region import header as h
from shmgen.runtime.region.record_locks import WRITER_LOCK, lock_byte

from ..runtime.messages import PosePublisher, pose
from .conftest import PEER, REPOSITORY
from .test_doctor import PUBLISHER, find_fault, read_faults, root_only

ESCAPES = b"evil\x1b]0;owned\x07\n\x9b31m\xe2\x80\xae/msg/X"
ESCAPED = "evil\\u001b]0;owned\\u0007\\u000a\\x9b31m\\xe2\\x80\\xae/msg/X"


@pytest.fixture
def region(topic, file):
    """A function that writes bytes into the file of a region with one sample."""
    with PosePublisher(topic) as publisher:
        publisher.publish(pose(1.0))

    def write(offset, data):
        with file.open("r+b") as stream:
            stream.seek(offset)
            stream.write(data)

    return write


@pytest.mark.slow
def test_escape_sequences_in_a_type_name_are_escaped(topic, file, region, shmgen):
    region(32, ESCAPES.ljust(64, b"\0"))
    results = {
        name: shmgen(*command, topic) if command[0] != "top" else shmgen(*command)
        for name, command in {
            "doctor": ["doctor"],
            "doctor --json": ["doctor", "--json"],
            "top": ["top", "--once", "-d", "0.1"],
            "top --json": ["top", "--once", "-d", "0.1", "--json"],
            "echo": ["echo", "--once"],
            "pub": ["pub", "--once"],
            "hz": ["hz", "--timeout", "0.1"],
            "clean": ["clean", "--dry-run"],
        }.items()
        if command[0] != "pub"
    }
    with file.open("r+b") as stream:
        assert lock_byte(stream.fileno(), WRITER_LOCK)  # `pub` would replace a region without a writer
        results["pub"] = shmgen("pub", topic, "std_msgs/String", "--once")
    for name, result in results.items():
        text = result.stdout + result.stderr
        assert all(line.isprintable() for line in text.replace("\t", " ").split("\n")), (name, text)
    for name in ("doctor", "top", "echo", "pub"):
        assert ESCAPED in results[name].stdout + results[name].stderr, name
    (row,) = [row for row in json.loads(results["top --json"].stdout) if row["topic"] == topic]
    assert row["type"] == ESCAPED


def test_escape_sequences_in_a_value_are_escaped(topic, shmgen):
    text = "a\x9b31m\u202etxt\u2066\U000e0041 ü😀"
    shmgen("pub", topic, "std_msgs/String", json.dumps({"data": text}), "--once")
    line = shmgen("echo", topic, "--once", "--json").stdout.rstrip("\n")
    assert line.isprintable()
    assert "ü😀" in line
    assert json.loads(line) == {"data": text}
    for options in ([], ["--csv"], ["--csv", "--field", "data"]):
        output = shmgen("echo", topic, "--once", *options).stdout
        assert output.replace("\n", "").isprintable()
        assert "ü😀" in output


@pytest.mark.parametrize(
    ("offset", "data", "message"),
    [
        (28, struct.pack("<I", 0), "the number of slots is 0"),
        (28, struct.pack("<I", 3), "the number of slots is 3"),
        (28, struct.pack("<I", 2**31), "need 549,755,814,080"),
        (20, struct.pack("<I", 2**32 - 1), "need 17,179,869,372"),
        (20, struct.pack("<I", 0), "its slots have 0 bytes, too few for 56 + 16"),
        (16, struct.pack("<I", 2**32 - 1), "its slots have 128 bytes, too few for 4294967295 + 16"),
        (4, struct.pack("<H", 7), "ABI 7"),
    ],
)
@pytest.mark.family("ABI 7")
def test_damaged_header_is_reported_by_every_tool(topic, file, region, shmgen, offset, data, message):
    region(offset, data)
    other = f"{topic}_whole"
    with PosePublisher(other) as publisher:
        publisher.publish(pose(1.0))
        result = shmgen("top", "--once", "-d", "0.1", "--json")
        assert (result.code, result.stderr) == (0, "")
        rows = {row["topic"]: row for row in json.loads(result.stdout)}
        assert message in rows[topic]["type"]
        assert rows[topic]["type"].startswith("damaged: ")
        assert rows[other]["type"] == "geometry_msgs/msg/Pose"
        assert shmgen("top", "--once", "-d", "0.1").code == 0
    assert message in find_fault(shmgen, topic)["message"]
    for command in ("echo", "hz"):
        result = shmgen(command, topic, "--timeout", "1")
        assert result.code == 1
        assert f"{topic}: error[SHM702]: the region is damaged: " in result.stderr
        assert message in result.stderr
    assert shmgen("clean", topic).stdout.endswith(f"removed {file}\n")


def test_impossible_header_values_crash_no_tool(topic, region, shmgen):
    region(128, b"\xff" * 16)
    region(148, b"\xff" * 44)
    assert shmgen("top", "--once", "-d", "0.1").code == 0
    shmgen("hz", topic, "--timeout", "0.1")
    assert "no sample within" in shmgen("hz", topic, "--timeout", "0.1").stderr
    assert shmgen("doctor", topic).code in (0, 1)


TRAPS = {
    "a FIFO": os.mkfifo,
    "a symbolic link": lambda path: path.symlink_to("/dev/shm/nowhere"),
    "a folder": os.mkdir,
}


@pytest.mark.sample("[region-a FIFO]", "[semaphore-a symbolic link]", "[event-a folder]")
@pytest.mark.parametrize("kind", TRAPS)
@pytest.mark.parametrize("place", ["region", "semaphore", "event"])
def test_fifo_symlink_or_folder_is_reported_and_not_opened(topic, file, semaphore, shmgen, started, kind, place):
    PosePublisher(topic).close()
    trap = {"region": file, "semaphore": semaphore, "event": semaphore.with_name(f"{semaphore.name}-event")}[place]
    trap.unlink(missing_ok=True)
    TRAPS[kind](trap)
    doctor = started("doctor", topic, "--json")
    findings = json.loads(doctor.communicate(timeout=20)[0])["findings"]
    (fault,) = [finding for finding in findings if not finding["note"]]
    assert fault["message"] == f"this is {kind} instead of a regular file, so programs refuse it"
    assert (fault["topic"], fault["file"]) == (topic, str(trap))
    for command in (["echo", topic, "--timeout", "0.1"], ["hz", topic, "--timeout", "0.1"], ["top", "--once"]):
        started(*command).communicate(timeout=20)
    clean = started("clean", topic)
    clean.communicate(timeout=20)
    if place == "region":
        assert clean.returncode == 1
        assert os.path.lexists(trap)
    trap.rmdir() if trap.is_dir() else trap.unlink(missing_ok=True)


@pytest.mark.parametrize("size", [0, 5])
def test_semaphore_file_of_wrong_size_is_a_fault(topic, semaphore, shmgen, size):
    PosePublisher(topic).close()
    semaphore.write_bytes(b"x" * size)
    assert f"the file of its semaphore has {size} bytes" in find_fault(shmgen, topic)["message"]


def test_world_writable_file_is_a_fault_unless_configured(topic, file, semaphore, tmp_path, shmgen):
    PosePublisher(topic).close()
    event = semaphore.with_name(f"{semaphore.name}-event")
    shutil.copy(semaphore, event)  # as a PLC creates it
    for path in (file, semaphore, event):
        path.chmod(0o666)
    findings = read_faults(shmgen("doctor", topic, "--json"))
    assert [finding["file"] for finding in findings] == [str(file), str(semaphore), f"{semaphore}-event"]
    assert {finding["message"] for finding in findings} == {
        "every user of this machine can write it, so programs refuse this file"
    }
    assert 'mode = "0666" under [regions]' in findings[0]["hint"]
    for finding in findings[:2]:
        subprocess.run(finding["hint"].split("`")[1], shell=True, check=True)
    assert len(read_faults(shmgen("doctor", topic, "--json"))) == 1
    for path in (file, semaphore):
        path.chmod(0o666)
    (tmp_path / "shmgen.toml").write_text('[regions]\nmode = "0666"\n')
    assert shmgen("doctor", topic).code == 0


@root_only
def test_file_of_another_user_is_reported_to_root(topic, file, semaphore, shmgen):
    shmgen("pub", topic, "std_msgs/String", "--once")
    for path in (file, semaphore):
        os.chown(path, 54321, 54321)
    result = shmgen("doctor", topic)
    assert result.code == 0
    assert result.stdout.count("but this program runs as root, so programs of root refuse this file") == 2
    assert 'group = "54321" under [regions] in shmgen.toml' in result.stdout
    echo_result = shmgen("echo", topic, "--timeout", "1")
    assert (echo_result.code, "but this program runs as root\n" in echo_result.stderr) == (1, True)


def test_escape_sequences_in_a_process_name_are_escaped(topic, shmgen, started):
    work = PEER.format(repository=str(REPOSITORY), work=PUBLISHER.format(topic=topic))
    command = [sys.executable, "-c", f"'\x1b]0;x\x07\u202e'\n{work}"]  # long command lines are shown without their end
    with subprocess.Popen(command, stdin=-1, stdout=-1) as process:
        process.stdout.readline()
        for tool in (["doctor", topic], ["top", "--once", "-d", "0.1"]):
            output = shmgen(*tool).stdout
            assert "\\u001b]0;x\\u0007\\u202e" in output
            assert output.replace("\n", "").isprintable()
        process.stdin.close()


def test_doctor_prints_no_escape_sequences_of_file_names(topic, shmgen, peer):
    """Print no control character, even if a process maps and removes a file with such a name."""
    holder = peer(f"""
import mmap
with open("/dev/shm/{region_name(topic)}\\u202e\\x07", "w+b") as opened:
    opened.write({h.pack(h.header_for("a/msg/B", 1, 8, 1)).ljust(4096, bytes(1))!r}); opened.flush()
    kept = mmap.mmap(opened.fileno(), 4096)
os.unlink(opened.name)
""")
    assert shmgen("doctor").stdout.replace("\n", "").isprintable()
    assert holder.poll() is None
