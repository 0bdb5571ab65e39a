"""A forked child keeps no claim of its parent and raises InForkedChild. Errors name the real holder of a claim."""

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


def run_in_child(work):
    """Run `work` in a forked child and return its result as text."""
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


def catch_error(call):
    try:
        call()
    except runtime.ShmError as error:
        return f"{type(error).__name__}: {error}"
    return "nothing"


def open_files():
    files = []
    for descriptor in os.listdir("/proc/self/fd"):
        with suppress(FileNotFoundError):  # the descriptor of this listing
            files.append(os.readlink(f"/proc/self/fd/{descriptor}"))
    return files


each_engine = pytest.mark.usefixtures("each_engine")


@each_engine
def test_forked_child_keeps_no_file_and_raises_an_error(topic):
    with PosePublisher(topic) as publisher, PoseSubscriber(topic) as subscriber:
        publisher.publish(pose(1))
        calls = [lambda: publisher.publish(pose(2)), publisher.heartbeat, subscriber.read, lambda: subscriber.wait(0)]
        for call in calls:
            answer = run_in_child(lambda call=call: catch_error(call))
            assert answer.startswith(f"InForkedChild: {topic}: this ")
            assert f"was opened by process {os.getpid()} before a fork" in answer
        assert f"/dev/shm/{runtime.region_name(topic)}" in open_files()
        names = run_in_child(open_files)
        assert "pipe:" in names
        assert runtime.region_name(topic) not in names
        run_in_child(lambda: (publisher.close(), subscriber.close()))
        publisher.publish(pose(3))
        assert subscriber.read().position.x == 3.0


@each_engine
def test_forked_child_may_open_its_own_subscriber(topic):
    with PosePublisher(topic) as publisher:
        publisher.publish(pose(1))

        def read_newest():
            with PoseSubscriber(topic) as subscriber:
                return subscriber.read().position.x

        assert run_in_child(read_newest) == "1.0"


@pytest.mark.usefixtures("in_python")
def test_fork_or_interrupt_while_closing_keeps_no_claim(topic):
    """Close the map's own file descriptor as well, because an open descriptor keeps the claim."""
    publisher = PosePublisher(topic)
    region, names = publisher._end.region, []
    map = region.map

    class Map:
        def close(self):
            if names:
                map.close()
                return
            names.append("")
            names[0] = run_in_child(open_files)
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
def test_child_forked_while_close_waits_keeps_no_file(topic):
    """Create the child in a signal handler, while close() waits (up to WAKE_MS) for another thread's wait()."""
    name, answers = f"/dev/shm/{runtime.region_name(topic)}", []
    deadline = time.monotonic() + 30 * machine.slower

    def fork(*_):
        if name in open_files():  # in the parent: close() has not finished
            answers.append(run_in_child(lambda: (catch_error(subscriber.read).split(":")[0], name in open_files())))

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
def test_close_releases_the_claim_before_a_child_has_run(topic):
    """Release the claim although a child still has the file open. Duplicated descriptors simulate the child."""
    publisher = PosePublisher(topic)
    name = f"/dev/shm/{runtime.region_name(topic)}"
    fds = [int(fd) for fd in os.listdir("/proc/self/fd") if os.path.exists(f"/proc/self/fd/{fd}")]
    copies = [os.dup(fd) for fd in fds if os.readlink(f"/proc/self/fd/{fd}") == name]  # like those of a child
    assert copies
    try:
        with pytest.raises(runtime.RegionInUse):
            PosePublisher(topic)
        publisher.close()
        PosePublisher(topic).close()
    finally:
        for fd in copies:
            os.close(fd)


@each_engine
def test_child_of_a_fork_in_c_keeps_no_claim(topic):
    """Call fork() in C, so that Python runs no fork handlers in the child."""
    publisher = PosePublisher(topic)
    pid = ctypes.PyDLL(None).fork()
    if pid == 0:
        time.sleep(600)
        os._exit(0)
    try:
        publisher.close()
        with PosePublisher(topic) as next_publisher:
            next_publisher.publish(pose(1))
    finally:
        os.kill(pid, signal.SIGKILL)
        os.waitpid(pid, 0)


@pytest.mark.usefixtures("in_python")
@pytest.mark.exhaustive
def test_fork_between_any_two_instructions_keeps_no_claim(topic):
    """Create a child at every 37th instruction of the endpoints' calls. The child has neither file nor map."""
    name, leaking_functions, forks = runtime.region_name(topic), [], 0

    def use_topic():
        with PosePublisher(topic) as publisher, PoseSubscriber(topic) as subscriber:
            publisher.publish(pose(1))
            assert subscriber.read()

    def has_inherited():
        maps = open("/proc/self/maps").read()  # noqa: SIM115 the child ends
        return f"/dev/shm/{name}" in maps or any(f"/dev/shm/{name}" in file for file in open_files())

    def fork_at(step):
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
                    if run_in_child(has_inherited) == "True":
                        leaking_functions.append(frame.f_code.co_name)
            return trace

        with traced(trace):
            use_topic()
        return left <= 0

    steps = iter(range(1, 100_000, 37))
    while fork_at(next(steps)):
        pass
    assert forks > 100
    # In these functions, a new descriptor or view is not yet assigned to its name.
    assert set(leaking_functions) <= {
        "opened",
        "_open",
        "open_region",
        "_open_or_create",
        "_read_maps",
        "close_after_fork",
        "__init__",
        "ordered",
        "keeps_order",
    }
    assert len(leaking_functions) <= forks // 30, (leaking_functions, forks)


@pytest.mark.usefixtures("in_python")
def test_fork_during_a_copy_leaves_the_lock_to_the_parent(topic):
    """Create a child during a copy. The child inherits its parent's note of the lock, but not the lock."""
    with PosePublisher(topic) as publisher, PoseSubscriber(topic) as subscriber:
        region, states = publisher._end.region, []

        def fork():
            run_in_child(lambda: None)
            states.append((region.semaphore.value, region.words[h.LOCK_HOLDER], is_repairing()))

        def is_repairing():
            """Return True if this process holds the repair lock, which conflicts with a second descriptor."""
            with open(f"/dev/shm/{runtime.region_name(topic)}", "rb") as file:
                query = _FLOCK.pack(fcntl.F_WRLCK, os.SEEK_SET, REPAIR_LOCK, 1, 0)
                kind, *_ = _FLOCK.unpack(fcntl.fcntl(file.fileno(), fcntl.F_OFD_GETLK, query))
                return kind != fcntl.F_UNLCK

        swap_map(publisher, fork)
        publisher.publish(pose(1))
        assert record_locks.lock_byte(region.file, REPAIR_LOCK)
        assert publisher._end.lock.acquire()
        fork()
        publisher._end.lock.release()
        assert states == [(0, os.getpid(), False), (0, os.getpid(), True)]
        assert region.semaphore.value == 1
        assert subscriber.read().position.x == 1.0


@pytest.mark.usefixtures("in_python")
def test_fork_while_opening_keeps_no_claim(topic, monkeypatch):
    """Create the child just after the claim, as another thread can."""
    names = []

    def claim_and_fork(*arguments):
        result = yield from claim(*arguments)
        names.append(run_in_child(open_files))
        return result

    claim = writer.claim
    monkeypatch.setattr(writer, "claim", claim_and_fork)
    PosePublisher(topic).close()
    assert "pipe:" in names[0]
    assert runtime.region_name(topic) not in names[0]


def is_claimed(topic):
    region = region_of(topic)
    return record_locks.byte_is_locked(region.file, WRITER_LOCK)


@pytest.mark.usefixtures("each_engine")
def test_fork_between_two_steps_of_opening_keeps_no_claim(topic):
    """Create the child while the opening watches the heartbeat of a PLC, as another thread can."""
    PoseSubscriber(topic).close()
    region_of(topic).words[h.WRITER] = h.PLC
    publisher = PosePublisher.__new__(PosePublisher)
    end = publisher._begin(topic)
    while not is_claimed(topic):
        assert end.step() is not None
    names = run_in_child(open_files)
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
def test_claim_ends_with_the_parent_not_with_its_children(topic):
    folder = os.path.dirname(__file__)
    command = [sys.executable, "-c", PARENT, topic]
    with subprocess.Popen(command, cwd=folder, stdout=subprocess.PIPE, text=True) as parent:
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
fork = ctypes.PyDLL(None).fork  # runs no fork handlers of Python
pid = fork()
if pid:
    print(pid, flush=True)
    os._exit(0)
time.sleep(600)
"""


@pytest.mark.parametrize(
    ("line", "locked_bytes"),
    [
        ("lock:\t1: OFDLCK ADVISORY  WRITE -1 00:19:42 1 1", [1]),
        ("lock:\t1: OFDLCK ADVISORY  WRITE -1 00:19:42 0 1", [0, 1]),
        ("lock:\t1: OFDLCK ADVISORY  WRITE -1 00:19:42 1 EOF", [1, 2]),
        ("lock:\t1: POSIX  ADVISORY  WRITE 77 00:19:42 0 EOF", []),
        ("ino:\t1: OFDLCK ADVISORY  WRITE -1 00:19:42 0 EOF", []),
    ],
)
def test_locked_bytes_are_read_from_fdinfo(tmp_path, line, locked_bytes):
    info = tmp_path / "fdinfo"
    info.write_text(f"pos:\t0\nflags:\t02100002\n{line}\n")
    assert [byte for byte in range(3) if record_locks._locks(str(info), byte)] == locked_bytes


@pytest.mark.slow
@each_engine
def test_error_names_the_child_that_holds_the_claim(topic):
    """Name a child that C forked. Its parent, whose process id is in the header, is dead."""
    folder = os.path.dirname(__file__)
    run = subprocess.Popen([sys.executable, "-c", HIDDEN, topic], cwd=folder, stdout=subprocess.PIPE, text=True)
    child = int(run.stdout.readline())
    run.wait()
    run.stdout.close()
    try:
        with pytest.raises(runtime.RegionInUse, match=f"process {child} publishes already"):
            PosePublisher(topic)
        for command, expected in (("doctor", f"writer: process {child} "), ("clean", f"process {child} ")):
            line = [sys.executable, "-m", "shmgen", command, topic]
            result = subprocess.run(line, capture_output=True, text=True, check=False, timeout=60 * machine.slower)
            assert expected in result.stdout + result.stderr
    finally:
        os.kill(child, signal.SIGKILL)


def test_child_forked_while_a_map_buffer_is_in_use_keeps_no_claim(topic, monkeypatch, in_python):
    """Create the child while the writer wakes a reader. The parent is killed, and the child continues."""
    read_end, write_end = os.pipe()

    def ring(map):
        word = ctypes.c_uint32.from_buffer(map)
        if os.fork() == 0:
            os.write(write_end, os.getpid().to_bytes(4, "little"))  # the fork handlers have run
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
    child = int.from_bytes(os.read(read_end, 4), "little")
    try:
        PosePublisher(topic).close()
    finally:
        os.kill(child, signal.SIGKILL)
        os.close(read_end), os.close(write_end)
