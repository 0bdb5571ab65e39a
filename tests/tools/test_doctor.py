"""Tests of `shmgen doctor`: real processes cause each fault, and doctor reports it."""

from __future__ import annotations

import grp
import itertools
import json
import os
import re
import shutil
import struct
import subprocess
import sys
from contextlib import contextmanager, nullcontext
from pathlib import Path
from types import SimpleNamespace

import posix_ipc
import pytest

import shmgen.tools.doctor.clean
import shmgen.tools.watch.overview
import shmgen.tools.watch.screen  # noqa: F401 become_nobody() may not be able to read them
from shmgen.runtime import RegionUnusable, Subscriber, region_name
from shmgen.runtime.reference import memory_order
from shmgen.runtime.region import header as h
from shmgen.runtime.region.access import RegionOptions, way_in
from shmgen.tools.doctor import checks, snapshot
from tests.support.engines import use_python

from ..runtime.messages import Pose, PosePublisher
from ..support.command import PRELOAD, run
from .conftest import REPOSITORY

PUBLISHER = "publisher = PosePublisher({topic!r}); publisher.publish(pose(1.0))"
BITS = 64 if sys.maxsize > 2**32 else 32
root_only = pytest.mark.skipif(os.geteuid() != 0, reason="only root can change the user or mount another /dev/shm")


def read_faults(result):
    return [finding for finding in json.loads(result.stdout)["findings"] if not finding["note"]]


def find_fault(shmgen, topic):
    """Run doctor, and return the only fault."""
    result = shmgen("doctor", topic, "--json")
    assert result.code == 1
    (fault,) = read_faults(result)
    assert fault["topic"] == topic
    assert fault["hint"]
    return fault


def test_healthy_region_has_no_faults(topic, shmgen, peer):
    writer = peer(PUBLISHER.format(topic=topic))
    result = shmgen("doctor", topic)
    assert (result.code, result.stderr) == (0, "")
    lines = result.stdout.splitlines()
    assert lines[0].startswith(f"{topic}  geometry_msgs/msg/Pose, 2 slots, 1 sample, 4,096 bytes, ")
    assert lines[1].startswith(f"  writer: process {writer.pid} (")
    assert lines[1].endswith("), alive")
    assert lines[2] == "  lock: free, acquired 0 times per second"
    assert lines[-1] == "1 region, no faults"

    (region,) = json.loads(shmgen("doctor", topic, "--json").stdout)["regions"]
    assert (region["topic"], region["writer_pid"], region["semaphore"]) == (topic, writer.pid, 1)
    assert region["processes"] == [{"pid": writer.pid, "name": region["processes"][0]["name"], "bits": BITS}]


def test_ended_writer_is_no_fault(topic, shmgen, peer):
    peer(PUBLISHER.format(topic=topic) + "; publisher.close()").kill()
    result = shmgen("doctor", topic)
    assert result.code == 0
    assert ", ended\n" in result.stdout


def test_lock_held_by_a_killed_process_is_a_fault(topic, semaphore, shmgen, peer):
    acquire = "; region_of(publisher).semaphore.acquire(); region_of(publisher).words[h.LOCK_HOLDER] = os.getpid()"
    holder = peer(PUBLISHER.format(topic=topic) + acquire)
    fault = find_fault(shmgen, topic)
    assert f"its lock has been held by process {holder.pid} (" in fault["message"]
    holder.kill()
    os.waitid(os.P_PID, holder.pid, os.WEXITED | os.WNOWAIT)  # a zombie, until its parent waits for it
    fault = find_fault(shmgen, topic)
    assert f"held by process {holder.pid}, which is dead, for 1." in fault["message"]
    assert (fault["file"], fault["process"]) == (str(semaphore), holder.pid)


def test_busy_lock_is_no_fault(topic, shmgen, peer):
    busy = """
import threading, time
def work():
    while True:
        region_of(publisher).semaphore.acquire()
        region_of(publisher).words[h.LOCK_COUNT] += 1
        time.sleep(0.02)
        region_of(publisher).semaphore.post()
threading.Thread(target=work, daemon=True).start()
"""
    peer(PUBLISHER.format(topic=topic) + busy)
    assert shmgen("doctor", topic).code == 0


def test_surplus_semaphore_token_is_a_fault(topic, semaphore, shmgen, peer):
    post = "import posix_ipc; posix_ipc.Semaphore('/' + region_of(publisher).name).release()"
    peer(f"{PUBLISHER.format(topic=topic)}; {post}")
    fault = find_fault(shmgen, topic)
    assert "its semaphore is 2" in fault["message"]
    assert "returns to 1 automatically" in fault["hint"]
    assert fault["file"] == str(semaphore)


def test_missing_or_replaced_semaphore_is_a_fault(topic, semaphore, shmgen, peer):
    writer = peer(PUBLISHER.format(topic=topic))
    semaphore.unlink()
    fault = find_fault(shmgen, topic)
    assert "its semaphore is missing" in fault["message"]
    assert fault["hint"] == f"restart process {writer.pid}"
    posix_ipc.Semaphore("/" + region_name(topic), posix_ipc.O_CREX, mode=0o660, initial_value=1).close()
    semaphore.chmod(0o660)
    fault = find_fault(shmgen, topic)
    assert "uses a semaphore that was removed" in fault["message"]
    assert fault["process"] == writer.pid


def test_layout_that_differs_from_the_folder_is_a_fault(topic, tmp_path, shmgen):
    small = '[strings]\n"std_msgs/String.data" = 20\n'
    (tmp_path / "shmgen.toml").write_text('messages = ["std_msgs/String"]\n' + small)
    assert shmgen("pub", topic, "std_msgs/String", "--once").code == 0
    result = shmgen("doctor", topic)
    assert (result.code, "layout: same as shmgen.toml" in result.stdout) == (0, True)

    (tmp_path / "shmgen.toml").write_text('messages = ["std_msgs/String"]\n')
    fault = find_fault(shmgen, topic)
    assert "another layout of std_msgs/msg/String than this folder" in fault["message"]
    assert "21 bytes in the region" in fault["message"]
    assert "81 bytes, by shmgen.toml" in fault["message"]

    (tmp_path / "shmgen.toml").write_text(small)
    shmgen("generate", "std_msgs/String", "-q")
    assert "layout: same as generated/layout.lock" in shmgen("doctor", topic).stdout


@pytest.mark.parametrize(
    ("entry", "message"),
    [
        ('type = "std_msgs/String"\ndepth = 4', "the region has 2 slots, but depth = 4 in shmgen.toml needs 8"),
        ('type = "std_msgs/Bool"', "the region has type std_msgs/msg/String, but shmgen.toml has std_msgs/Bool"),
    ],
)
def test_depth_or_type_that_differs_from_toml_is_a_fault(entry, message, topic, tmp_path, shmgen):
    assert shmgen("pub", topic, "std_msgs/String", "--once").code == 0
    (tmp_path / "shmgen.toml").write_text(f'[[topics]]\ntopic = "{topic}"\n{entry}\n')
    assert find_fault(shmgen, topic)["message"] == message


def test_truncated_file_or_other_abi_is_a_fault(topic, file, shmgen):
    shmgen("pub", topic, "std_msgs/String", "--once")
    with file.open("r+b") as stream:
        stream.truncate(300)
    assert "need 704" in find_fault(shmgen, topic)["message"]
    with file.open("r+b") as stream:
        stream.truncate(4096)
        stream.seek(4)
        stream.write(b"\1")
    assert "another version of shmgen created it: ABI 1" in find_fault(shmgen, topic)["message"]


def test_semaphore_with_fewer_permissions_is_a_fault(topic, semaphore, shmgen):
    shmgen("pub", topic, "std_msgs/String", "--once")
    semaphore.chmod(0o600)
    fault = find_fault(shmgen, topic)
    assert "some users can read, but not lock" in fault["message"]
    subprocess.run(fault["hint"].strip("`"), shell=True, check=True)
    assert shmgen("doctor", topic).code == 0


def test_mode_or_group_that_differs_from_toml_is_a_fault(topic, file, semaphore, tmp_path, shmgen):
    group = grp.getgrgid(os.getegid()).gr_name
    (tmp_path / "shmgen.toml").write_text(f'[regions]\nmode = "0600"\ngroup = "{group}"\n')
    shmgen("pub", topic, "std_msgs/String", "--once")
    assert file.stat().st_mode & 0o777 == 0o600
    assert shmgen("doctor", topic).code == 0
    (tmp_path / "shmgen.toml").write_text('[regions]\nmode = "0660"\ngroup = "plc"\n')
    findings = read_faults(shmgen("doctor", topic, "--json"))
    assert {finding["file"] for finding in findings} == {str(file), str(semaphore)}
    assert [finding["message"] for finding in findings][:2] == [
        'the mode is 0600, but shmgen.toml has mode = "0660"',
        f'the group is {group}, but shmgen.toml has group = "plc"',
    ]
    for finding in findings:
        if "mode" in finding["message"]:
            subprocess.run(finding["hint"].strip("`"), shell=True, check=True)
    assert len(read_faults(shmgen("doctor", topic, "--json"))) == 2
    assert "groupadd plc" in shmgen("pub", topic, "std_msgs/String", "--once").stderr


def test_mode_reduced_by_a_umask_is_only_a_note(topic, file, semaphore, shmgen):
    """Find files whose creator was killed before it set their mode."""
    shmgen("pub", topic, "std_msgs/String", "--once")
    for path in (file, semaphore):
        path.chmod(0o640)
    result = shmgen("doctor", topic)
    assert result.code == 0
    assert result.stdout.count("note: the mode is 0640: the group may read the file, but also needs to write it") == 2
    assert f"`chmod g+w {semaphore}`" in result.stdout


def test_process_using_a_removed_region_is_a_fault(topic, file, shmgen, peer):
    writer = peer(PUBLISHER.format(topic=topic))
    file.unlink()
    fault = find_fault(shmgen, topic)
    assert "still uses a region that was removed" in fault["message"]
    assert (fault["process"], fault["hint"]) == (writer.pid, f"restart process {writer.pid}")
    writer.kill()
    writer.wait()
    assert "no such region" in shmgen("doctor", topic).stderr


NOBODY = ["setpriv", "--reuid=65534", "--regid=65534", "--clear-groups"]


@pytest.fixture
def doctor_as_nobody(topic):
    """A function that runs `shmgen doctor` as a user without access to the files and processes of others."""
    for module in ("posix_ipc", "shmgen.tools.doctor.doctor", "tests.runtime.messages"):
        command = [*NOBODY, sys.executable, "-c", f"import {module}"]
        if not shutil.which("setpriv") or subprocess.run(command, cwd=REPOSITORY, capture_output=True).returncode:
            pytest.skip("another user cannot read this checkout")

    def doctor(*arguments):
        command = [*NOBODY, sys.executable, "-m", "shmgen", "doctor", *arguments, "--json"]
        return json.loads(subprocess.run(command, cwd="/", capture_output=True, check=False).stdout)

    return doctor


@root_only
@pytest.mark.parametrize(
    "cleanup",
    [
        "own = '/proc/self/fd/'; "
        "[os.close(int(name)) for name in os.listdir(own) if os.path.realpath(own + name) == {file!r}]",
        "import mmap; opened = open({file!r}, 'r+b'); kept = mmap.mmap(opened.fileno(), 0); publisher.close(); "
        "del publisher",
    ],
    ids=["its file", "its semaphore"],
)
def test_user_finds_the_removed_region_of_an_own_process(topic, file, doctor_as_nobody, shmgen, peer, cleanup):
    """Read the process's descriptors or its semaphore, because only root can read map_files."""
    writer = peer(f"{PUBLISHER}; {cleanup}".format(topic=topic, file=str(file)), *NOBODY)
    file.unlink()
    for topics in ((), (topic,)):
        findings = [finding for finding in doctor_as_nobody(*topics)["findings"] if finding["topic"] == topic]
        assert [(finding["process"], finding["note"]) for finding in findings] == [(writer.pid, False)]
        assert "still uses a region that was removed" in findings[0]["message"]
    assert find_fault(shmgen, topic)["process"] == writer.pid  # run as root


OWN = ["unshare", "-m", "sh", "-c", 'mount -t tmpfs tmpfs /dev/shm && exec "$@"', "sh"]


@pytest.fixture
def container(peer):
    """A function that starts a process with a separate /dev/shm."""
    if os.geteuid() or not shutil.which("unshare") or subprocess.run([*OWN, "true"], capture_output=True).returncode:
        pytest.skip("only root can create mount namespaces")
    return lambda work, *before: peer(work, *OWN, *before)


PAIR = """
import time
parent, (opened, open_now) = os.getpid(), os.pipe()
if not os.fork():
    os.close(1)
    kept = PoseSubscriber({topic!r})
    os.write(open_now, b"1")
    while os.getppid() == parent:
        time.sleep(0.05)
    os._exit(0)
os.read(opened, 1)
publisher = PosePublisher({topic!r})
"""
"""Two processes that use the region, like a cell that runs completely in one container."""


def test_single_process_in_another_dev_shm_is_a_fault(topic, shmgen, peer, container):
    peer(PUBLISHER.format(topic=topic))
    process = container(PUBLISHER.format(topic=topic))
    fault = find_fault(shmgen, topic)
    assert "in another /dev/shm, so neither side sees the other" in fault["message"]
    assert fault["process"] == process.pid


@pytest.mark.slow
def test_complete_container_is_no_fault(topic, tmp_path, doctor_as_nobody, shmgen, peer, container):
    """Accept containers with all peers of a region, whether or not this /dev/shm has the same region."""
    own_findings = lambda report: [f for f in report["findings"] if f["topic"].startswith(topic)]  # noqa: E731
    container(PAIR.format(topic=f"{topic}_a"))
    container(PAIR.format(topic=f"{topic}_a"))
    container(PAIR.format(topic=f"{topic}_b"), *NOBODY)
    container(PUBLISHER.format(topic=f"{topic}_c"))  # a single process, with a topic that this /dev/shm does not have
    assert own_findings(json.loads(shmgen("doctor", "--json").stdout)) == []
    assert own_findings(doctor_as_nobody()) == []
    peer(PAIR.format(topic=f"{topic}_a"))
    assert own_findings(json.loads(shmgen("doctor", "--json").stdout)) == []
    (tmp_path / "shmgen.toml").write_text(f'[[topics]]\ntopic = "{topic}_b"\ntype = "std_msgs/Bool"\n')
    assert own_findings(json.loads(shmgen("doctor", "--json").stdout)) == []
    (tmp_path / "shmgen.toml").write_text(f'[[topics]]\ntopic = "{topic}_c"\ntype = "std_msgs/Bool"\n')
    (finding,) = own_findings(json.loads(shmgen("doctor", "--json").stdout))
    assert "in another /dev/shm" in finding["message"]


def test_region_only_in_a_container_is_reported_if_named(topic, shmgen, container):
    container(PAIR.format(topic=topic))
    findings = read_faults(shmgen("doctor", topic, "--json"))
    assert len(findings) == 2
    assert all("in another /dev/shm" in finding["message"] for finding in findings)


@pytest.mark.parametrize(
    ("value", "waiters", "dead", "expected"),
    [
        (0, 1, False, "its lock has been held by process {holder} ("),
        (0, 0, True, "its lock has been held by process {holder}, which is dead, for 1."),
        (1, 1, True, ""),
        (2, 0, True, "the value of its semaphore is 2, so 2 processes can hold the lock at once"),
    ],
)
@pytest.mark.family("[0-0-True")
def test_semaphore_of_a_32_bit_process_is_decoded(topic, semaphore, file, shmgen, value, waiters, dead, expected):
    """Decode the layout of glibc: the lowest bit records waiters, the bits above are the value (internaltypes.h)."""
    holder = 2**22 + 1 if dead else os.getpid()
    shmgen("pub", topic, "std_msgs/String", "--once")
    semaphore.write_bytes(struct.pack("<4I", value << 1 | waiters, 128, 0, waiters))
    with file.open("r+b") as region:
        region.seek(4 * h.LOCK_HOLDER)
        region.write(struct.pack("<I", holder))
    if expected:
        assert expected.format(holder=holder) in find_fault(shmgen, topic)["message"]
    else:
        result = shmgen("doctor", topic)
        assert ("  lock: free, acquired 0 times per second" in result.stdout, result.code) == (True, 0)
    report = json.loads(shmgen("doctor", topic, "--json").stdout)
    assert report["regions"][0]["semaphore"] == value


@pytest.mark.parametrize(("machine", "barrier"), [("x86_64", False), ("aarch64", False), ("aarch64", True)])
@pytest.mark.skipif(BITS == 32, reason="this Python has 32 bits itself, and no compiler here makes a program of 64")
@pytest.mark.skipif(not shutil.which("i686-linux-gnu-gcc"), reason="no i686-linux-gnu-gcc: make test-all as root")
@pytest.mark.family("[x86_64-False]")
def test_process_of_other_bitness_is_a_fault(topic, file, tmp_path, shmgen, peer, machine, barrier, monkeypatch):
    """Suggest only settings that the runtime accepts on that machine."""
    (tmp_path / "small.c").write_text(
        "#include <fcntl.h>\n#include <stdio.h>\n#include <sys/mman.h>\n"
        "int main(int n, char **v) {\n"
        "  mmap(0, 4096, PROT_READ, MAP_SHARED, open(v[1], O_RDONLY), 0);\n"
        '  puts("ready"); fflush(stdout); return getchar() == 0;\n}\n'
    )
    program = str(tmp_path / "small")
    subprocess.run(["i686-linux-gnu-gcc", "-static", "-o", program, program + ".c"], check=True)
    peer(PUBLISHER.format(topic=topic))
    monkeypatch.setattr(os, "uname", lambda: SimpleNamespace(machine=machine))
    use_python(monkeypatch)
    monkeypatch.setattr(checks, "IN_C", False)
    monkeypatch.setattr(memory_order, "_membarrier", lambda: barrier or None)
    with subprocess.Popen([program, file], stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True) as small:
        if small.stdout.readline() != "ready\n":
            pytest.skip("this kernel runs no 32-bit programs")
        fault = find_fault(shmgen, topic)
    assert f"process {small.pid} (small" in fault["message"]
    assert "has 32 bits" in fault["message"]
    assert fault["process"] == small.pid
    is_suggested = 'write sync = "sequence" under [regions]' in fault["hint"]
    assert is_suggested == (barrier or machine == "x86_64")
    assert is_suggested or "run only 32-bit or only 64-bit programs" in fault["hint"]
    with nullcontext() if is_suggested else pytest.raises(RegionUnusable, match=f"sequence.*{machine}"):
        kind = type("Lockless", (Pose,), {"_regions_": RegionOptions(sync="sequence")})
        type("LocklessSubscriber", (Subscriber,), {"message_type": kind})(f"{topic}_sequence").close()


@contextmanager
def become_nobody():
    """Run this process as another user, who may be unable to import modules from the checkout."""
    groups = os.getgroups()
    os.setgroups([])
    os.setresgid(65534, 65534, 0)
    os.setresuid(65534, 65534, 0)
    try:
        yield
    finally:
        os.setresuid(0, 0, 0)
        os.setresgid(0, 0, 0)
        os.setgroups(groups)


@pytest.mark.slow
@root_only
def test_user_without_permission_gets_advice(topic, file, shmgen):
    shmgen("pub", topic, "std_msgs/String", "--once")
    commands = ["topics"], ["top", "--once"], ["info", topic[:-1]]
    for command in (["doctor", topic], *commands):  # import their modules before the user changes
        shmgen(*command)
    with become_nobody():
        result = run(["doctor", topic, "--json"], Path("/"))
        clean_result = run(["clean", topic], Path("/"))
        errors = [run(command, Path("/")).stderr for command in commands]
    (fault,) = read_faults(result)
    assert result.code == 1
    assert fault["file"] == str(file)
    assert "this user cannot read it" in fault["message"]
    for text in (fault["hint"], clean_result.stderr):
        assert "usermod" not in text  # a user should not join root for one file
        assert "set `group` under [regions]" in text
    assert clean_result.code == 1
    assert f"{file} belongs to root:root with mode 660" in clean_result.stderr
    for text in errors[:2]:
        assert re.search(r"this user may not read \d+ regions?; `shmgen doctor` shows how to fix this", text)
        assert "no regions" not in text
    assert f"did you mean {topic}?" in errors[2]


@root_only
@pytest.mark.parametrize("mode", ["755", "700", "777"])
@pytest.mark.family("[777]")
def test_wrong_mode_of_dev_shm_is_a_fault(mode, tmp_path):
    """Report the mode also to a user who may not open the folder. The test mounts its own /dev/shm."""
    program = tmp_path / "as_nobody.py"
    program.write_text(
        f"{PRELOAD}\nos.chdir('/'); os.setgroups([]); os.setresgid(9, 9, 9); os.setresuid(9999, 9999, 9999)\n"
        "shmgen.cli.main.main()\n"
    )
    mount = f"mount -t tmpfs -o mode={mode} tmpfs /dev/shm && exec"
    command = ["unshare", "--mount", "sh", "-c", f'{mount} "$@"', "sh", sys.executable, str(program)]
    process = subprocess.run([*command, "doctor"], capture_output=True, text=True, check=False)
    if process.returncode and "unshare" in process.stderr:
        pytest.skip("no mount namespaces here")
    assert f"fault: the mode of /dev/shm is 0{mode} instead of 1777" in process.stdout, process.stderr
    assert "`sudo chmod 1777 /dev/shm`" in process.stdout
    assert process.returncode == 1
    if mode == "700":
        stderr = subprocess.run([*command, "topics"], capture_output=True, text=True, check=False).stderr
        assert "this user may not list /dev/shm; `shmgen doctor` shows how to fix this" in stderr


@pytest.mark.parametrize(
    ("gid", "mode", "advice"),
    [
        (0, 0o660, "do not join root"),
        (12345, 0o660, "`sudo usermod -aG 12345 $USER`"),
        (12345, 0o640, "its group may not open it either"),
    ],
)
def test_advice_never_suggests_to_join_root(gid, mode, advice):
    status = os.stat_result((0o100000 | mode, 1, 1, 1, 12345, gid, 0, 0, 0, 0))
    assert advice in way_in(status)


def test_file_that_is_no_region_is_reported_by_every_tool(topic, file, shmgen):
    file.write_bytes(b"hello\n")
    message = f"{file} is not a region of shmgen (magic 16#6C6C6568), 6 bytes"
    hint = f"hint: `ls -l {file}` shows the owner; remove the file, or use another topic"
    results = [
        shmgen(*command, topic, *options)
        for command, options in (
            (["echo"], ["--timeout", "1"]),
            (["doctor"], []),
            (["pub"], ["geometry_msgs/Pose", "--once"]),
            (["clean", "--force"], []),
            (["info"], []),
            (["hz"], ["--timeout", "1"]),
        )
    ]
    with pytest.raises(RegionUnusable) as error:
        PosePublisher(topic)
    for text in (*(result.stdout + result.stderr for result in results), str(error.value)):
        assert message in text
        assert hint in text
        assert "no such region" not in text
    assert [result.code for result in results] == [1] * 6
    assert file.read_bytes() == b"hello\n"
    file.write_bytes(b"")
    (fault,) = read_faults(shmgen("doctor", topic, "--json"))
    assert fault["message"] == "its header is not complete yet"


def test_unknown_topic_gets_a_suggestion(topic, shmgen):
    shmgen("pub", topic, "std_msgs/String", "--once")
    result = shmgen("doctor", topic[:-1])
    assert (result.code, result.stdout) == (1, "")
    assert result.stderr.endswith(f"  hint: did you mean {topic}?\n")


def test_doctor_lists_only_regions(topic, file, shmgen):
    shmgen("pub", topic, "std_msgs/String", "--once")
    foreign = Path(f"{file}_foreign")
    foreign.write_bytes(b"somebody's" * 100)
    pipe = Path(f"{file}_pipe")
    os.mkfifo(pipe)
    topics = [region["topic"] for region in json.loads(shmgen("doctor", "--json").stdout)["regions"]]
    assert topic in topics
    assert topic + "_foreign" not in topics
    assert topic + "_pipe" not in topics


@pytest.mark.parametrize("arguments", [("doctor", "--json"), ("topics", "--json"), ("clean", "--all", "--dry-run")])
@pytest.mark.family("[arguments2]")
def test_region_may_vanish_at_any_system_call(arguments, topic, file, semaphore, shmgen, monkeypatch):
    """Remove the files before the command's first system call on them, then before the second, until the last."""

    def count_calls(call):
        def counting_call(path, *others, **keywords):
            nonlocal calls
            if region_name(topic) in str(path):
                calls += 1
                if calls == moment:
                    file.unlink()
                    semaphore.unlink()
            return call(path, *others, **keywords)

        return counting_call

    monkeypatch.setattr(snapshot, "_WATCH", 0)
    for moment in itertools.count(1):
        shmgen("pub", topic, "std_msgs/String", "--once")
        calls = 0
        with monkeypatch.context() as patch:
            for name in ("access", "lstat", "open", "stat"):
                patch.setattr(os, name, count_calls(getattr(os, name)))
            result = shmgen(*arguments)
        assert "No such file" not in result.stderr
        assert topic not in result.stderr
        assert arguments[0] != "doctor" or topic not in [fault["topic"] for fault in read_faults(result)]
        if calls < moment:
            break
    assert moment > 3
