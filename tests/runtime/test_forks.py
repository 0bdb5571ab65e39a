"""A forked child: it holds nothing of its parent, and is told so; and who really holds a claim."""

from __future__ import annotations

import ctypes
import fcntl
import os
import signal
import subprocess
import sys
import threading
import time
from contextlib import suppress

import pytest

from shmgen import runtime
from shmgen.core.abi import REPAIR_LOCK
from shmgen.runtime import engine
from shmgen.runtime.reference import writer
from shmgen.runtime.region import header as h
from shmgen.runtime.region import record_locks
from shmgen.runtime.region.record_locks import _FLOCK, WRITER_LOCK

from ..rigs.chaos_faults import swap_map
from ..support import machine
from ..support.region_of import region_of
from ..support.tracing import traced
from .messages import WHY_NOT, PosePublisher, PoseSubscriber, pose


def in_child(work):
    """What `work` returns in a forked child, as text."""
    read, write = os.pipe()
    pid = os.fork()
    if pid == 0:
        try:
            os.write(write, str(work()).encode())
            os._exit(0)
        finally:
            os._exit(1)
    os.close(write)
    assert os.waitpid(pid, 0)[1] == 0
    with open(read) as answers:
        return answers.read()


def told(call):
    try:
        call()
    except runtime.ShmError as error:
        return f"{type(error).__name__}: {error}"
    return "nothing"


def open_files():
    found = []
    for descriptor in os.listdir("/proc/self/fd"):
        with suppress(FileNotFoundError):  # that of this list
            found.append(os.readlink(f"/proc/self/fd/{descriptor}"))
    return found


each_engine = pytest.mark.usefixtures("each_engine")


@each_engine
def test_a_child_holds_nothing_and_is_told(topic):
    with PosePublisher(topic) as publisher, PoseSubscriber(topic) as subscriber:
        publisher.publish(pose(1))
        calls = [lambda: publisher.publish(pose(2)), publisher.heartbeat, subscriber.read, lambda: subscriber.wait(0)]
        for call in calls:
            answer = in_child(lambda call=call: told(call))
            assert answer.startswith(f"InForkedChild: {topic}: this ")
            assert f"belongs to process {os.getpid()}, from which this one was forked" in answer
        assert f"/dev/shm/{runtime.region_name(topic)}" in open_files()
        names = in_child(open_files)
        assert "pipe:" in names
        assert runtime.region_name(topic) not in names
        in_child(lambda: (publisher.close(), subscriber.close()))
        publisher.publish(pose(3))
        assert subscriber.read().position.x == 3.0


@each_engine
def test_a_child_opens_its_own(topic):
    with PosePublisher(topic) as publisher:
        publisher.publish(pose(1))

        def own():
            with PoseSubscriber(topic) as subscriber:
                return subscriber.read().position.x

        assert in_child(own) == "1.0"


@pytest.mark.usefixtures("in_python")
def test_a_fork_or_an_exception_in_the_middle_of_closing(topic):
    """The map has a descriptor of its own, and with it the claim."""
    publisher = PosePublisher(topic)
    region, names = publisher._end.region, []
    map = region.map

    class Map:
        def close(self):
            if names:
                map.close()
                return
            names.append("")
            names[0] = in_child(open_files)
            raise KeyboardInterrupt

    region.map = Map()
    with pytest.raises(KeyboardInterrupt):
        publisher.close()
    assert "pipe:" in names[0]
    assert runtime.region_name(topic) not in names[0]
    publisher.close()
    PosePublisher(topic).close()


@pytest.mark.skipif(not engine.IN_C, reason=WHY_NOT)
@pytest.mark.filterwarnings("ignore:.*multi-threaded.*fork:DeprecationWarning")
def test_a_child_forked_while_close_waits_for_another_thread(topic):
    """close() waits until the thread's wait() returns, up to WAKE_MS. A signal handler forks in the meantime."""
    name, answers = f"/dev/shm/{runtime.region_name(topic)}", []
    deadline = time.monotonic() + 30 * machine.slower

    def fork(*_):
        if name in open_files():  # in the parent: close() has not finished
            answers.append(in_child(lambda: (told(subscriber.read).split(":")[0], name in open_files())))

    def wait_until_closed():
        with suppress(runtime.Closed):
            subscriber.wait(60)

    before = signal.signal(signal.SIGALRM, fork)
    try:
        while len(answers) < 5 and time.monotonic() < deadline:
            subscriber = PoseSubscriber(topic)
            waiting = threading.Thread(target=wait_until_closed)
            waiting.start()
            time.sleep(0.01)  # usually enough for wait() to fall asleep
            signal.setitimer(signal.ITIMER_REAL, 0.0005)
            subscriber.close()
            signal.setitimer(signal.ITIMER_REAL, 0)
            waiting.join()
    finally:
        signal.setitimer(signal.ITIMER_REAL, 0)
        signal.signal(signal.SIGALRM, before)
    assert set(answers) == {"('InForkedChild', False)"}


@each_engine
def test_closing_does_not_wait_for_a_child_that_has_not_run_yet(topic):
    """Which has the file, and so the claim, until it has its turn."""
    publisher = PosePublisher(topic)
    name = f"/dev/shm/{runtime.region_name(topic)}"
    mine = [int(one) for one in os.listdir("/proc/self/fd") if os.path.exists(f"/proc/self/fd/{one}")]
    also = [os.dup(one) for one in mine if os.readlink(f"/proc/self/fd/{one}") == name]  # as a child has them
    assert also
    try:
        with pytest.raises(runtime.RegionInUse):
            PosePublisher(topic)
        publisher.close()
        PosePublisher(topic).close()
    finally:
        for one in also:
            os.close(one)


@each_engine
def test_a_child_that_touches_nothing_keeps_no_claim(topic):
    """Of a fork that Python knows nothing of, so that nothing is let go there."""
    publisher = PosePublisher(topic)
    pid = ctypes.PyDLL(None).fork()
    if pid == 0:
        time.sleep(600)
        os._exit(0)
    try:
        publisher.close()
        with PosePublisher(topic) as next_one:
            next_one.publish(pose(1))
    finally:
        os.kill(pid, signal.SIGKILL)
        os.waitpid(pid, 0)


@pytest.mark.usefixtures("in_python")
@pytest.mark.slow
def test_a_fork_between_any_two_instructions(topic):
    """Of opening, publishing, reading and closing, each 37th, by a child that has neither file nor map then."""
    name, held, forks = runtime.region_name(topic), [], 0

    def work():
        with PosePublisher(topic) as publisher, PoseSubscriber(topic) as subscriber:
            publisher.publish(pose(1))
            assert subscriber.read()

    def inherited():
        maps = open("/proc/self/maps").read()  # noqa: SIM115 the child ends
        return f"/dev/shm/{name}" in maps or any(f"/dev/shm/{name}" in file for file in open_files())

    def forked_at(step):
        nonlocal forks
        left = step

        def trace(frame, event, _):
            nonlocal left, forks
            if not frame.f_code.co_filename.startswith(os.path.dirname(runtime.__file__)):
                return None
            frame.f_trace_opcodes = True
            if event == "opcode":
                left -= 1
                if left == 0:
                    forks += 1
                    if in_child(inherited) == "True":
                        held.append(frame.f_code.co_name)
            return trace

        with traced(trace):
            work()
        return left <= 0

    steps = iter(range(1, 100_000, 37))
    while forked_at(next(steps)):
        pass
    assert forks > 100
    # Where a descriptor, or a view, is on its way from the call that made it to the name it gets.
    assert set(held) <= {
        "opened",
        "_open",
        "open_region",
        "_open_or_create",
        "_mapped",
        "close_after_fork",
        "__init__",
        "ordered",
        "keeps_order",
    }
    assert len(held) <= forks // 30, (held, forks)


@pytest.mark.usefixtures("in_python")
def test_a_fork_in_the_middle_of_a_copy_leaves_the_lock_to_the_parent(topic):
    """As by another thread, or by a signal handler: the child has the parent's note of the lock, and not the lock."""
    with PosePublisher(topic) as publisher, PoseSubscriber(topic) as subscriber:
        region, seen = publisher._end.region, []

        def fork():
            in_child(lambda: None)
            seen.append((region.semaphore.value, region.words[h.LOCK_HOLDER], repairing()))

        def repairing():
            """By us, whose own locks a second descriptor meets."""
            with open(f"/dev/shm/{runtime.region_name(topic)}", "rb") as file:
                asked = _FLOCK.pack(fcntl.F_WRLCK, os.SEEK_SET, REPAIR_LOCK, 1, 0)
                kind, *_ = _FLOCK.unpack(fcntl.fcntl(file.fileno(), fcntl.F_OFD_GETLK, asked))
                return kind != fcntl.F_UNLCK

        swap_map(publisher, fork)
        publisher.publish(pose(1))
        assert record_locks.lock_byte(region.file, REPAIR_LOCK)
        assert publisher._end.lock.acquire()
        fork()
        publisher._end.lock.release()
        assert seen == [(0, os.getpid(), False), (0, os.getpid(), True)]
        assert region.semaphore.value == 1
        assert subscriber.read().position.x == 1.0


@pytest.mark.usefixtures("in_python")
def test_a_fork_while_it_opens_takes_no_claim_along(topic, monkeypatch):
    """By another thread, just after the claim."""
    names = []

    def forked(*arguments):
        made = yield from claim(*arguments)
        names.append(in_child(open_files))
        return made

    claim = writer.claim
    monkeypatch.setattr(writer, "claim", forked)
    PosePublisher(topic).close()
    assert "pipe:" in names[0]
    assert runtime.region_name(topic) not in names[0]


def is_claimed(topic):
    region = region_of(topic)
    return record_locks.byte_is_locked(region.file, WRITER_LOCK)


@pytest.mark.usefixtures("each_engine")
def test_a_fork_between_two_steps_of_an_opening_takes_no_claim_along(topic):
    """As by another thread: a PLC's claim is watched meanwhile."""
    PoseSubscriber(topic).close()
    region_of(topic).words[h.WRITER] = h.PLC
    publisher = PosePublisher.__new__(PosePublisher)
    end = publisher._begin(topic)
    while not is_claimed(topic):
        assert end.step() is not None
    names = in_child(open_files)
    assert "pipe:" in names
    assert runtime.region_name(topic) not in names
    end.close()
    assert not is_claimed(topic)


PARENT = """
import multiprocessing, os, sys, time
from messages import PosePublisher
publisher = PosePublisher(sys.argv[1])
def work():
    print(os.getpid(), flush=True)
    time.sleep(600)
multiprocessing.get_context("fork").Process(target=work).start()
time.sleep(600)
"""


@each_engine
def test_the_claim_ends_with_the_parent_and_not_with_its_children(topic):
    where = os.path.dirname(__file__)
    command = [sys.executable, "-c", PARENT, topic]
    with subprocess.Popen(command, cwd=where, stdout=subprocess.PIPE, text=True) as parent:
        child = int(parent.stdout.readline())
        try:
            with pytest.raises(runtime.RegionInUse, match=f"process {parent.pid} publishes already"):
                PosePublisher(topic)
            parent.kill()
            parent.wait()
            os.kill(child, 0)
            with PosePublisher(topic) as publisher:
                publisher.publish(pose(1))
        finally:
            os.kill(child, signal.SIGKILL)


HIDDEN = """
import ctypes, os, sys, time
from messages import PosePublisher
publisher = PosePublisher(sys.argv[1])
fork = ctypes.PyDLL(None).fork  # Python is not told
pid = fork()
if pid:
    print(pid, flush=True)
    os._exit(0)
time.sleep(600)
"""


@pytest.mark.parametrize(
    ("line", "held"),
    [
        ("lock:\t1: OFDLCK ADVISORY  WRITE -1 00:19:42 1 1", [1]),
        ("lock:\t1: OFDLCK ADVISORY  WRITE -1 00:19:42 0 1", [0, 1]),
        ("lock:\t1: OFDLCK ADVISORY  WRITE -1 00:19:42 1 EOF", [1, 2]),
        ("lock:\t1: POSIX  ADVISORY  WRITE 77 00:19:42 0 EOF", []),
        ("ino:\t1: OFDLCK ADVISORY  WRITE -1 00:19:42 0 EOF", []),
    ],
)
def test_which_bytes_a_process_has_locked(tmp_path, line, held):
    info = tmp_path / "fdinfo"
    info.write_text(f"pos:\t0\nflags:\t02100002\n{line}\n")
    assert [byte for byte in range(3) if record_locks._locks(str(info), byte)] == held


@pytest.mark.slow
@each_engine
def test_who_really_holds_the_claim_is_named(topic):
    """A child of a fork that Python knows nothing of; its parent, whose pid stands in the header, is dead."""
    where = os.path.dirname(__file__)
    run = subprocess.Popen([sys.executable, "-c", HIDDEN, topic], cwd=where, stdout=subprocess.PIPE, text=True)
    child = int(run.stdout.readline())
    run.wait()
    run.stdout.close()
    try:
        with pytest.raises(runtime.RegionInUse, match=f"process {child} publishes already"):
            PosePublisher(topic)
        for command, expected in (("doctor", f"writer: process {child} "), ("clean", f"process {child} ")):
            line = [sys.executable, "-m", "shmgen", command, topic]
            shown = subprocess.run(line, capture_output=True, text=True, check=False, timeout=60 * machine.slower)
            assert expected in shown.stdout + shown.stderr
    finally:
        os.kill(child, signal.SIGKILL)


def test_a_child_forked_while_a_buffer_of_the_map_is_in_use_keeps_no_claim(topic, monkeypatch, in_python):
    """As in the middle of a ring of the bell; its parent is killed, the child lives on."""
    told, tell = os.pipe()

    def ring(map):
        word = ctypes.c_uint32.from_buffer(map)
        if os.fork() == 0:
            os.write(tell, os.getpid().to_bytes(4, "little"))  # by itself: what it does in a fork is done then
            time.sleep(60)
            os._exit(word.value)
        os.kill(os.getpid(), signal.SIGKILL)

    monkeypatch.setattr(writer, "ring", ring)
    parent = os.fork()
    if parent == 0:
        publisher = PosePublisher(topic)
        region_of(publisher).words[h.ARMED] = 1
        publisher.publish(pose(1))
    os.waitpid(parent, 0)
    child = int.from_bytes(os.read(told, 4), "little")
    try:
        PosePublisher(topic).close()
    finally:
        os.kill(child, signal.SIGKILL)
        os.close(told), os.close(tell)
