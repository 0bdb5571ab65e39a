"""`shmgen clean`: what it removes, and what it leaves alone."""

from __future__ import annotations

import os
import subprocess
import sys
import threading
import time
from pathlib import Path

import pytest

from shmgen.runtime import header as h

from ..runtime.messages import PosePublisher
from .test_doctor import PUBLISHER


def files_of(file):
    return sorted(str(path) for path in file.parent.glob(f"*{file.name}*"))


def test_removes_region_and_semaphores(topic, file, semaphore, shmgen, peer):
    peer(PUBLISHER.format(topic=topic)).communicate()
    event = Path(f"{semaphore}-event")
    event.touch()
    planned = shmgen("clean", topic, "--dry-run")
    assert planned.stdout == f"would remove {event}\nwould remove {semaphore}\nwould remove {file}\n"
    assert len(files_of(file)) == 3
    result = shmgen("clean", topic)
    assert (result.code, result.stderr) == (0, "")
    assert result.stdout == f"removed {event}\nremoved {semaphore}\nremoved {file}\n"
    assert files_of(file) == []
    gone = shmgen("clean", topic)
    assert (gone.code, "no such region" in gone.stderr) == (1, True)


def test_not_under_a_living_writer_unless_forced(topic, file, shmgen, peer):
    writer = peer(PUBLISHER.format(topic=topic))
    before = files_of(file)
    result = shmgen("clean", topic)
    assert (result.code, result.stdout) == (1, "")
    assert result.stderr.startswith(f"error: {topic}: process {writer.pid} (")
    assert "publishes on it\n  hint: stop it first" in result.stderr
    assert files_of(file) == before
    assert shmgen("clean", topic, "--force").code == 0
    assert files_of(file) == []


def test_not_under_a_reader(topic, file, shmgen, peer):
    reader = peer(f"subscriber = PoseSubscriber({topic!r})")
    result = shmgen("clean", topic)
    assert result.code == 1
    assert f"process {reader.pid} (" in result.stderr
    assert "has it open\n" in result.stderr
    reader.kill()
    reader.wait()
    assert shmgen("clean", topic).code == 0
    assert files_of(file) == []


def test_what_a_killed_writer_left(topic, file, shmgen, peer):
    writer = peer(PUBLISHER.format(topic=topic) + "; publisher._region.semaphore.acquire()")
    writer.kill()
    writer.wait()
    assert shmgen("clean", topic).code == 0
    assert files_of(file) == []


def test_not_under_a_plc(topic, file, shmgen):
    """A PLC takes no record lock, and lives in a process that this user may not look into: its heartbeat tells."""
    PosePublisher(topic).close()
    ended = threading.Event()

    def beat():
        with file.open("r+b", buffering=0) as opened:
            beats = 0
            while not ended.is_set():
                beats += 1
                os.pwrite(opened.fileno(), beats.to_bytes(4, "little"), 4 * h.HEARTBEAT)
                time.sleep(0.01)

    with file.open("r+b", buffering=0) as opened:
        os.pwrite(opened.fileno(), h.PLC.to_bytes(4, "little"), 4 * h.WRITER)
    plc = threading.Thread(target=beat)
    plc.start()
    try:
        result = shmgen("clean", topic)
    finally:
        ended.set()
        plc.join()
    assert (result.code, "a PLC publishes on it" in result.stderr) == (1, True)
    assert shmgen("clean", topic).code == 0


def test_what_is_not_ours_stays(topic, file, shmgen):
    file.write_bytes(b"the work of somebody else")
    for arguments in ((topic,), (topic, "--force")):
        result = shmgen("clean", *arguments)
        assert result.code == 1
        assert "is no region of ours" in result.stderr
    assert file.read_bytes() == b"the work of somebody else"
    file.unlink()
    os.mkfifo(file)
    assert shmgen("clean", topic).code == 1
    assert file.is_fifo()


def test_what_makers_left_that_died_early(topic, file, semaphore, shmgen):
    for left in (b"", bytes(4096), bytes(4) + b"\1\0\xc0\0".ljust(4092, b"\0")):
        file.write_bytes(left)
        assert shmgen("clean", topic).stdout == f"removed {file}\n"
    semaphore.write_bytes(bytes(32))
    assert shmgen("clean", topic).stdout == f"removed {semaphore}\n"
    assert files_of(file) == []


def test_all_means_all_of_ours(shmgen, tmp_path):
    """In a /dev/shm of its own, for other tests have regions too."""
    script = """
import os, sys
from tests.runtime.messages import PosePublisher
PosePublisher("/a").close()
used = PosePublisher("/b/c")
open("/dev/shm/foreign", "w").write("x" * 300)
sys.argv = ["shmgen", "clean", "--all"]
from shmgen import cli
try:
    cli.main()
finally:
    print(*sorted(os.listdir("/dev/shm")))
"""
    own = ["unshare", "-m", "sh", "-c", 'mount -t tmpfs tmpfs /dev/shm && exec "$@"', "sh"]
    repository = Path(__file__).parents[2]
    result = subprocess.run(
        [*own, sys.executable, "-c", script], cwd=repository, capture_output=True, text=True, check=False
    )
    if result.stderr.startswith(("mount", "unshare")):
        pytest.skip("no namespaces here")
    assert result.returncode == 1
    *removed, left = result.stdout.splitlines()
    assert {"removed /dev/shm/sem.a", "removed /dev/shm/a"} <= set(removed)
    assert not any("b.c" in line for line in removed)
    assert {"b.c", "foreign", "sem.b.c"} == {name for name in left.split() if not name.endswith("-event")}
    assert "/b/c: process" in result.stderr


def test_topics_or_all(shmgen):
    for arguments in ((), ("--all", "/a")):
        result = shmgen("clean", *arguments)
        assert (result.code, "Name topics, or --all" in result.stderr) == (2, True)
