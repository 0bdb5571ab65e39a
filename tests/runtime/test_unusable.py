"""Unusable files and systems are reported before their use, and damaged semaphores stop no endpoint."""

from __future__ import annotations

import errno
import os
import resource
import subprocess
import sys
import time
from contextlib import suppress
from unittest.mock import Mock

import posix_ipc
import pytest

from shmgen import runtime
from shmgen.runtime import engine
from shmgen.runtime.errors import RegionUnusable
from shmgen.runtime.reference import opening
from shmgen.runtime.region import checks, names
from shmgen.runtime.region import header as h
from shmgen.runtime.region.access import RegionOptions

from ..conftest import REPOSITORY
from ..support import machine
from ..support.build import committed_texts, put
from ..support.guard import within
from ..support.region_of import region_of
from .messages import Pose, PosePublisher, PoseSubscriber, pose

MANY = 2**31 - 3
in_python = pytest.mark.usefixtures("in_python")


@pytest.mark.parametrize(
    "data",
    [b"", b"\0" * 5, b"\xff" * checks._OURS, b"\1" * checks._OURS, b"\0" * 4096],
    ids=["empty", "short", "ones", "garbage", "long"],
)
def test_file_that_is_no_semaphore_is_refused(topic, semaphore_file, data):
    """Use a child process, because the C library would end a process that uses the file."""
    PosePublisher(topic).close()
    semaphore_file.write_bytes(data)
    code = f"from messages import *; PosePublisher({topic!r}).publish(pose(1))"
    folder = os.path.dirname(__file__)
    done = subprocess.run(
        [sys.executable, "-c", code], cwd=folder, capture_output=True, text=True, timeout=60 * machine.slower
    )
    assert done.returncode == 1, done.returncode
    assert f"RegionUnusable: {semaphore_file} is not a semaphore" in done.stderr


def test_semaphore_of_another_word_size_is_refused(topic, semaphore_file):
    """Compare sizes: glibc's sem_t has 16 bytes in 32-bit programs and 32 bytes in 64-bit programs."""
    PosePublisher(topic).close()
    data = semaphore_file.read_bytes()
    semaphore_file.write_bytes(data[:16] if len(data) == 32 else data + bytes(16))
    with pytest.raises(runtime.RegionUnusable, match=r'bit program, which this \d\d-bit .*clean.*sync = "sequence"'):
        PosePublisher(topic)


@pytest.mark.parametrize("error", [OSError(22, "Invalid argument"), ValueError("unrecognized configuration name")])
@in_python
def test_other_c_library_than_glibc_is_refused(topic, file, semaphore_file, monkeypatch, error):
    """Pretend confstr() of musl, where /dev/shm/NAME would be both the region and the semaphore."""

    def confstr(name):
        raise error

    monkeypatch.setattr(os, "confstr", confstr)
    with pytest.raises(RegionUnusable, match=r'musl \(Alpine\) does not have: .* sync = "sequence"'):
        PosePublisher(topic)
    assert not file.exists()
    assert not semaphore_file.exists()
    kind = type("Lockless", (Pose,), {"_regions_": RegionOptions(sync="sequence")})
    type("LocklessSubscriber", (runtime.Subscriber,), {"message_type": kind})(topic).close()


def test_other_python_than_cpython_is_refused(tmp_path):
    """Report one sentence, both from the runtime and from generated code."""
    put({path: text for path, text in committed_texts().items() if path.startswith("python/")}, tmp_path)
    code = "import sys; sys.implementation.name = 'pypy'; import "
    for module in ("shmgen.runtime", "shm_msgs"):
        paths = {"PYTHONPATH": f"{REPOSITORY}/src:{tmp_path}/python"}
        done = subprocess.run(
            [sys.executable, "-c", code + module], env=os.environ | paths, capture_output=True, text=True
        )
        assert done.stderr.splitlines()[-1].startswith(
            "ImportError: shmgen.runtime needs CPython 3.10 or later, but this"
        )


def test_lack_of_file_descriptors_is_reported(topic):
    limits = resource.getrlimit(resource.RLIMIT_NOFILE)
    resource.setrlimit(resource.RLIMIT_NOFILE, (256, limits[1]))
    descriptors = []
    try:
        with suppress(OSError):
            while True:
                descriptors.append(os.open("/dev/null", os.O_RDONLY))
        spare = 0
        while spare < 20:
            try:
                PosePublisher(topic).close()
                break
            except runtime.RegionUnusable as error:
                text = str(error)
            os.close(descriptors.pop())
            spare += 1
    finally:
        for descriptor in descriptors:
            os.close(descriptor)
        resource.setrlimit(resource.RLIMIT_NOFILE, limits)
    assert 1 < spare < 20, text
    assert "Too many open files" in text or "maximum number of files open" in text  # the latter from posix_ipc


@in_python
def test_failed_opening_keeps_no_descriptor_open(topic, monkeypatch):
    """Close the descriptors even if the caller keeps the error, whose traceback references the local variables."""

    def refuse(*_):
        raise runtime.RegionUnusable("for once")

    PosePublisher(topic).close()
    monkeypatch.setattr(opening, "open_semaphore", refuse)
    before = os.listdir("/proc/self/fd")
    with pytest.raises(runtime.RegionUnusable, match="for once") as caught:
        PosePublisher(topic)
    assert len(os.listdir("/proc/self/fd")) == len(before), caught.traceback


@in_python
@pytest.mark.parametrize(
    ("error", "text"), [(errno.ENOSPC, "no space for 4096 bytes"), (errno.EIO, "Input/output error")]
)
def test_failed_opening_leaves_no_file(topic, file, monkeypatch, error, text):
    def refuse(*_):
        raise OSError(error, os.strerror(error))

    with monkeypatch.context() as patch:
        patch.setattr(os, "posix_fallocate", refuse)
        with pytest.raises(runtime.RegionUnusable, match=text):
            PosePublisher(topic)
    assert not file.exists()
    PosePublisher(topic).close()


@in_python
@pytest.mark.parametrize("place", [names.region_file, names.semaphore_file])
def test_opening_gives_up_on_a_file_that_keeps_vanishing(topic, monkeypatch, place):
    """Pretend that another process removes the file at each attempt, between the opening and the last check."""
    leads_to = checks.leads_to
    attempts = []

    def pretend_removal(path, file):
        if path == place(runtime.region_name(topic)):
            attempts.append(path)
            return False
        return leads_to(path, file)

    monkeypatch.setattr(checks, "leads_to", pretend_removal)
    with pytest.raises(runtime.RegionUnusable, match="another program keeps removing"):
        PosePublisher(topic)
    assert len(attempts) >= 10 - 1


@in_python
def test_opening_gives_up_if_a_file_both_exists_and_is_missing(topic, monkeypatch):
    monkeypatch.setattr(opening, "opened", Mock(side_effect=FileNotFoundError))
    monkeypatch.setattr(os, "open", Mock(side_effect=FileExistsError))
    with pytest.raises(runtime.RegionUnusable, match="another program keeps removing"):
        PosePublisher(topic)


@in_python
@pytest.mark.parametrize("error", [posix_ipc.ExistentialError, posix_ipc.PermissionsError])
def test_semaphore_changed_before_opening_is_retried_or_refused(topic, monkeypatch, error):
    open_semaphore = opening.Semaphore
    tries = Mock(side_effect=[error, open_semaphore])
    monkeypatch.setattr(opening, "Semaphore", lambda *arguments: tries()(*arguments))
    if error is posix_ipc.PermissionsError:
        with pytest.raises(runtime.PermissionDenied, match=r"join (the|its) group|do not join root"):
            PosePublisher(topic)
    else:
        PosePublisher(topic).close()
        assert tries.call_count == 2


@in_python
def test_region_removed_by_its_creator_is_recreated(topic, file, monkeypatch):
    """Recreate a region that its creator removes while another endpoint opens it."""
    complete = opening._complete_header
    calls = []

    def complete_and_remove(*arguments):
        yield from complete(*arguments)
        if not calls:
            file.unlink()
        calls.append(1)

    monkeypatch.setattr(opening, "_complete_header", complete_and_remove)
    with PosePublisher(topic) as publisher:
        publisher.publish(pose(1))
    assert len(calls) == 2
    assert runtime.read_header(runtime.region_name(topic)).newest == 1


@pytest.mark.parametrize("recoveries", [0, 1])
@pytest.mark.parametrize("value", [3, 1000, MANY])
def test_surplus_posts_stop_no_endpoint(topic, value, recoveries):
    """Write the value into the file of the semaphore, because a test cannot post so often."""
    guard = within(5 * machine.slower)
    with guard, PosePublisher(topic) as publisher, PoseSubscriber(topic) as subscriber:
        region_of(publisher).words[h.RECOVERIES] = recoveries
        with open(f"/dev/shm/sem.{region_of(publisher).name}", "r+b") as file:
            file.write((value if sys.maxsize > 2**32 else value << 1).to_bytes(4, "little"))  # the format of glibc
        semaphore = posix_ipc.Semaphore("/" + region_of(publisher).name)
        longest = 0.0
        for number in range(1, 30):
            before = time.process_time()
            publisher.publish(pose(number))
            assert subscriber.read().position.x == number
            longest = max(longest, time.process_time() - before)
        assert longest < 0.5 * machine.slower
        # On x86 the reader in C does not take the lock.
        acquisitions = 29 if engine.IN_C and machine.keeps_order() else 58
        assert semaphore.value == max(1, value - acquisitions * 65)
        semaphore.close()
        assert (publisher.lock_misses, subscriber.lock_misses) == (0, 0)


@pytest.mark.skipif(not engine.IN_C, reason="the reference has no event")
def test_full_event_stops_no_endpoint(topic):
    with PosePublisher(topic) as publisher, PoseSubscriber(topic) as subscriber:
        assert subscriber.wait(0) is None
        with open(f"/dev/shm/sem.{region_of(publisher).name}-event", "r+b") as file:
            file.write((2**31 - 1).to_bytes(4, "little"))
        region_of(publisher).words[h.ARMED] = 1
        publisher.publish(pose(1))
        assert subscriber.wait(1).position.x == 1.0
        before = time.monotonic()
        assert subscriber.wait(0.05) is None
        assert time.monotonic() - before >= 0.05


REFUSED = """
import sys
from tests.support import seccomp
from tests.runtime.messages import PosePublisher
from shmgen import runtime

seccomp.forbid(285, int(sys.argv[2]))  # fallocate
try:
    PosePublisher(sys.argv[1])
except runtime.RegionUnusable as error:
    print(error)
"""


@pytest.mark.skipif(machine.EMULATED or os.uname().machine != "x86_64", reason="needs seccomp, and calls of x86-64")
@pytest.mark.parametrize("pure", ["", "1"], ids=["C", "Python"])
@pytest.mark.parametrize("number", [errno.EPERM, errno.ENOSYS])
def test_sandbox_that_refuses_fallocate_is_reported(topic, file, number, pure):
    done = subprocess.run(
        [sys.executable, "-c", REFUSED, topic, str(number)],
        cwd=REPOSITORY, env=os.environ | {"SHMGEN_PURE": pure}, capture_output=True, text=True, check=True,
    )  # fmt: skip
    assert done.stdout == (
        f"{file}: the system call fallocate is refused here ({os.strerror(number)}); allow it in the sandbox or the "
        "seccomp profile of this process\n"
    )
    assert not file.exists()
