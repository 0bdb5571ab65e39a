"""Tests of `shmgen clean`: the files that it removes, and the files that it keeps."""

from __future__ import annotations

import os
import subprocess
import sys
import threading
import time
from pathlib import Path

import pytest

from shmgen.runtime.region import header as h

from ..runtime.messages import PosePublisher
from ..support import machine
from .test_doctor import PUBLISHER


def list_files(file):
    return sorted(str(path) for path in file.parent.glob(f"*{file.name}*"))


def test_clean_removes_region_and_semaphores(topic, file, semaphore, shmgen, peer):
    peer(PUBLISHER.format(topic=topic)).communicate()
    event = Path(f"{semaphore}-event")
    event.touch()
    dry_run = shmgen("clean", topic, "--dry-run")
    assert dry_run.stdout == f"would remove {event}\nwould remove {semaphore}\nwould remove {file}\n"
    assert len(list_files(file)) == 3
    result = shmgen("clean", topic)
    assert (result.code, result.stderr) == (0, "")
    assert result.stdout == f"removed {event}\nremoved {semaphore}\nremoved {file}\n"
    assert list_files(file) == []
    second = shmgen("clean", topic)
    assert (second.code, "no such region" in second.stderr) == (1, True)


def test_clean_refuses_a_region_with_a_writer_unless_forced(topic, file, shmgen, peer):
    writer = peer(PUBLISHER.format(topic=topic))
    before = list_files(file)
    result = shmgen("clean", topic)
    assert (result.code, result.stdout) == (1, "")
    assert result.stderr.startswith(f"{topic}: error[SHM702]: process {writer.pid} (")
    assert "publishes to it\n  hint: stop it first" in result.stderr
    assert list_files(file) == before
    assert shmgen("clean", topic, "--force").code == 0
    assert list_files(file) == []


def test_clean_refuses_a_region_with_a_reader(topic, file, shmgen, peer):
    reader = peer(f"subscriber = PoseSubscriber({topic!r})")
    result = shmgen("clean", topic)
    assert result.code == 1
    assert f"process {reader.pid} (" in result.stderr
    assert "uses it\n" in result.stderr
    reader.kill()
    reader.wait()
    assert shmgen("clean", topic).code == 0
    assert list_files(file) == []


def test_clean_removes_the_region_of_a_killed_writer(topic, file, shmgen, peer):
    writer = peer(PUBLISHER.format(topic=topic) + "; region_of(publisher).semaphore.acquire()")
    writer.kill()
    writer.wait()
    assert shmgen("clean", topic).code == 0
    assert list_files(file) == []


def test_clean_refuses_a_region_with_a_plc(topic, file, shmgen):
    """Identify a PLC by its heartbeat: a PLC has no record lock, and its process may be hidden."""
    PosePublisher(topic).close()
    stopping = threading.Event()

    def send_heartbeats():
        with file.open("r+b", buffering=0) as stream:
            beats = 0
            while not stopping.is_set():
                beats += 1
                os.pwrite(stream.fileno(), beats.to_bytes(4, "little"), 4 * h.HEARTBEAT)
                time.sleep(0.01)

    with file.open("r+b", buffering=0) as stream:
        os.pwrite(stream.fileno(), h.PLC.to_bytes(4, "little"), 4 * h.WRITER)
    plc = threading.Thread(target=send_heartbeats)
    plc.start()
    try:
        result = shmgen("clean", topic)
    finally:
        stopping.set()
        plc.join()
    assert (result.code, "a PLC publishes to it" in result.stderr) == (1, True)
    assert shmgen("clean", topic).code == 0


def test_clean_keeps_files_that_are_no_regions(topic, file, shmgen):
    file.write_bytes(b"the work of somebody else")
    for arguments in ((topic,), (topic, "--force")):
        result = shmgen("clean", *arguments)
        assert result.code == 1
        assert "is not a region of shmgen" in result.stderr
    assert file.read_bytes() == b"the work of somebody else"
    file.unlink()
    os.mkfifo(file)
    assert shmgen("clean", topic).code == 1
    assert file.is_fifo()


def test_clean_removes_incomplete_regions_and_semaphores(topic, file, semaphore, shmgen):
    for content in (b"", bytes(4096), bytes(4) + b"\1\0\xc0\0".ljust(4092, b"\0")):
        file.write_bytes(content)
        assert shmgen("clean", topic).stdout == f"removed {file}\n"
    semaphore.write_bytes(bytes(32))
    assert shmgen("clean", topic).stdout == f"removed {semaphore}\n"
    assert list_files(file) == []


OWN = ["unshare", "-m", "sh", "-c", 'mount -t tmpfs tmpfs /dev/shm && exec "$@"', "sh"]


def run_in_own_shm(script):
    """Run a script with a separate /dev/shm, because other tests have regions too."""
    command = [*OWN, sys.executable, "-c", script]
    result = subprocess.run(command, cwd=Path(__file__).parents[2], capture_output=True, text=True, check=False)
    if result.stderr.startswith(("mount", "unshare")):
        pytest.skip("only root can create mount namespaces")
    return result


@pytest.mark.slow
@pytest.mark.skipif(machine.EMULATED, reason="qemu-user has no seccomp")
def test_clean_all_removes_semaphores_of_killed_creators():
    """Stop one process at its link() and one at its unlink(), which seccomp forbids."""
    script = """
import mmap, os, sys, threading, time
from pathlib import Path
from tests.support import seccomp
from tests.support.command import run
from shmgen.tools.doctor import clean

def killed_at(call):
    pid = os.fork()
    if pid == 0:
        import posix_ipc
        seccomp.forbid(call)
        posix_ipc.Semaphore("/made", posix_ipc.O_CREX, mode=0o660, initial_value=1)
        os._exit(0)
    return os.waitstatus_to_exitcode(os.waitpid(pid, 0)[1])

# link and unlink, or linkat and unlinkat on machines without them.
wide = sys.maxsize > 2**32
LINK, UNLINK = (9, 10) if not wide else (86, 87) if os.uname().machine == "x86_64" else (37, 35)
assert (killed_at(LINK), killed_at(UNLINK)) == (-31, -31)
left = sorted(os.listdir("/dev/shm"))
assert len(left) == 3 and "sem.made" in left, left
shm = Path("/dev/shm")
# Random names could be words, so rename the files. Similar files in use, young files and files of regions stay.
for file, name in zip([shm / name for name in left if name != "sem.made"], ("sem.aB3dEf", "sem.7hIjKl")):
    file.rename(shm / name)
for name in ("sem.uSeD01", "sem.oPeN01", "sem.rEgI0n", "rEgI0n", "sem.camera", "sem.sIz3e1"):
    (shm / name).write_bytes(bytes(32 + (name == "sem.sIz3e1")))
with open(shm / "sem.uSeD01", "r+b") as used:
    map = mmap.mmap(used.fileno(), 32)
opened = open(shm / "sem.oPeN01")
print(run(["clean", "--all", "--dry-run"], Path("/")).stdout, end="")
time.sleep(clean.AGE)
young = shm / "sem.y0UnGx"
young.write_bytes(bytes(32))
def stay_young():  # even on a slow machine
    while True:
        os.utime(young)
        time.sleep(0.1)
threading.Thread(target=stay_young, daemon=True).start()
print(run(["doctor"], Path("/")).stdout)
print(run(["clean", "--all"], Path("/")).stdout)
print(*sorted(os.listdir("/dev/shm")))
"""
    result = run_in_own_shm(script)
    assert result.returncode == 0, result.stderr
    reported = [line.split()[-1] for line in result.stdout.splitlines() if line.startswith("    file: /dev/shm/sem")]
    removed = [line.split()[-1] for line in result.stdout.splitlines() if line.startswith("removed")]
    assert reported == removed == ["/dev/shm/sem.7hIjKl", "/dev/shm/sem.aB3dEf"]
    assert "would remove" not in result.stdout
    assert "note: a process was killed while it created a semaphore" in result.stdout
    assert result.stdout.splitlines()[-1].split() == [
        "rEgI0n", "sem.camera", "sem.made", "sem.oPeN01", "sem.rEgI0n", "sem.sIz3e1", "sem.uSeD01", "sem.y0UnGx",
    ]  # fmt: skip


def test_clean_all_removes_unused_regions_and_keeps_other_files():
    script = """
import os, sys
from tests.runtime.messages import PosePublisher
PosePublisher("/a").close()
used = PosePublisher("/b/c")
open("/dev/shm/foreign", "w").write("x" * 300)
sys.argv = ["shmgen", "clean", "--all"]
from shmgen.cli import main
try:
    main.main()
finally:
    print(*sorted(os.listdir("/dev/shm")))
"""
    result = run_in_own_shm(script)
    assert result.returncode == 1
    *removed, left = result.stdout.splitlines()
    assert {"removed /dev/shm/sem.a", "removed /dev/shm/a"} <= set(removed)
    assert not any("b.c" in line for line in removed)
    assert {"b.c", "foreign", "sem.b.c"} == {name for name in left.split() if not name.endswith("-event")}
    assert "/b/c: error[SHM702]: process" in result.stderr


def test_clean_requires_topics_or_all(shmgen):
    for arguments in ((), ("--all", "/a")):
        result = shmgen("clean", *arguments)
        assert (result.code, "Give topics or --all" in result.stderr) == (2, True)
