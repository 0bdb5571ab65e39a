"""Disturbs a live region, or the place where a region will be created, for chaos.py.

The functions in DURING disturb running processes: an exception from a signal handler, a fork at any instruction, too
many posts to a semaphore, or a long stop. A process that stops for so long counts as dead. The functions in BETWEEN run
when no process is left. They truncate a region, create a foreign file under one of its names, or fill /dev/shm, and
yield the faults that they find.
"""

from __future__ import annotations

import ctypes
import os
import random
import signal
import subprocess
import tempfile
import time
from collections.abc import Callable, Iterator
from contextlib import suppress
from pathlib import Path
from types import FrameType
from typing import Any

import posix_ipc

from shmgen.runtime import Closed, InForkedChild, RegionUnusable, ShmError, region_name
from shmgen.runtime.region.header import header_for
from shmgen.runtime.region.names import event_name, region_file, semaphore_file

from ..support.command import run

LONG_STOP = 1.15
"""Seconds of a stop. The holder of a lock counts as dead after one second, and so does the claim of a PLC."""
HANGS = 10
"""The timeout in seconds for opening a damaged region on a busy machine."""
_CHILD = (0.0, 0.005, 0.02, 3.0)
"""Seconds that a forked child lives. The longest exceeds the time that a new writer waits for the topic."""
_SPARE = 0.01
"""Seconds between two exceptions in one process, so that the process can handle the first one."""
_NEW_NAMESPACE = 0x20000
_PAGE = 4096
_MAGIC = 4
"""The size of the magic number in bytes."""


class Interrupted(BaseException):
    """The exception that a signal handler raises, at any instruction."""


def prepare(stage: Any, rng: random.Random, work: Callable[..., None]) -> None:
    """Install signal handlers in a process that executes `work`: SIGINT raises Interrupted, and SIGUSR1 forks.

    SIGINT raises only inside `work`, which catches the exception.
    """
    last, forking = 0.0, False

    def raise_interrupted(_: int, frame: FrameType | None) -> None:
        nonlocal last
        if forking:  # fork hooks of other modules, such as logging, cannot handle the exception
            return
        while frame and frame.f_code is not work.__code__:
            frame = frame.f_back
        if frame and (now := time.monotonic()) - last > _SPARE:
            last = now
            raise Interrupted

    def fork_child(*_: Any) -> None:
        # A descriptor has no owner yet while the call that creates it returns: docs/protocol.md, Forks.
        nonlocal forking
        if forking:  # inside a fork hook: the hook of concurrent.futures holds a lock and would deadlock
            return
        forking = True
        pause = rng.choice(_CHILD)  # before the fork, because the child has a copy of `rng`
        child = bool(stage.calls) and os.fork() == 0
        forking = False
        if child:
            try:
                for call in stage.calls:
                    _must_refuse(call, stage)
                time.sleep(pause)
            finally:
                os._exit(0)

    signal.signal(signal.SIGCHLD, signal.SIG_IGN)
    signal.signal(signal.SIGINT, raise_interrupted)
    signal.signal(signal.SIGUSR1, fork_child)


def _must_refuse(call: Callable[[], Any], stage: Any) -> None:
    try:
        call()
        stage.complain("a forked child used what its parent has open")
    except InForkedChild:
        pass
    except Closed:  # right if the parent's close() had ended: the child then inherits no open region
        if region_file(region_name(stage.topic)) in Path("/proc/self/maps").read_text():
            stage.complain("a forked child reports Closed and keeps the region open")
    except BaseException as error:
        stage.complain(f"a forked child raised {error!r}")


# --- while processes run -------------------------------------------------------------------------------------


def interrupt(stage: Any, actor: Any, rng: random.Random) -> None:
    actor.signal(signal.SIGINT)


def fork(stage: Any, actor: Any, rng: random.Random) -> None:
    actor.signal(signal.SIGUSR1)


def stop(stage: Any, actor: Any, rng: random.Random) -> None:
    actor.signal(signal.SIGSTOP)
    time.sleep(LONG_STOP)
    actor.signal(signal.SIGCONT)


def post(stage: Any, actor: Any, rng: random.Random) -> None:
    """Post up to three tokens to the lock, to the event semaphore, or to both."""
    name = region_name(stage.topic)
    for semaphore in rng.choice(((name,), (event_name(name),), (name, event_name(name)))):
        with suppress(posix_ipc.ExistentialError):
            opened = posix_ipc.Semaphore(f"/{semaphore}")
            for _ in range(rng.randint(1, 3)):
                opened.release()
            opened.close()


GENTLE = (interrupt, fork)
"""Mishaps that alone never make a recovery of the lock necessary."""
DURING = (interrupt, interrupt, interrupt, fork, fork, fork, post, post, post, stop)


# --- when no process is left ---------------------------------------------------------------------------------


def truncate_region(stage: Any, rng: random.Random) -> Iterator[str]:
    """Truncate a region that a process uses. Yield a fault if a later process or a tool crashes.

    The process that has the region mapped may crash.
    """
    child = _fork(lambda: _use(stage, rng.uniform(0.0, 0.05), for_ever=True))
    time.sleep(rng.uniform(0.05, 0.15))
    file, size = Path(region_file(region_name(stage.topic))), _PAGE
    if file.exists():
        size = rng.choice((0, 1, 100, 191, 192, 193, _PAGE - 1, _PAGE, max(0, file.stat().st_size - 1)))
        os.truncate(file, size)
    time.sleep(0.02)
    yield from _run_tools(stage)
    os.kill(child, signal.SIGKILL)
    os.waitpid(child, 0)
    yield from _try_to_open(stage, "a region that was cut short")
    yield from _clean_all(stage, known=not 0 < size < _MAGIC)
    yield from _try_to_open(stage, "no region", must_work=True)


def place_foreign_file(stage: Any, rng: random.Random) -> Iterator[str]:
    """Create a foreign file under a name of the region or a semaphore. Yield the faults of processes that open it."""
    name = region_name(stage.topic)
    place = Path(rng.choice((region_file(name), semaphore_file(name), semaphore_file(event_name(name)))))
    kind = rng.choice(("fifo", "folder", "link", "loop", "empty", "zeros", "noise", "ones", "large"))
    match kind:
        case "fifo":
            os.mkfifo(place)
        case "folder":
            place.mkdir()
        case "link":
            place.symlink_to("/etc/hostname")
        case "loop":
            place.symlink_to(place)
        case _:
            size = rng.choice((1, 16, 32, 192, _PAGE, 8 * _PAGE))
            data = {"empty": b"", "zeros": bytes(size), "noise": rng.randbytes(size), "ones": b"\xff" * size}
            place.write_bytes(data.get(kind, rng.randbytes(1 << 20)))
    before = Path("/etc/hostname").read_bytes()
    yield from _try_to_open(stage, f"a {kind} as {place.name.partition('.')[0]}")
    yield from _run_tools(stage)
    if Path("/etc/hostname").read_bytes() != before:
        yield "a link was followed and written to"
    if place.is_dir() and not place.is_symlink():
        place.rmdir()
    else:
        place.unlink(missing_ok=True)
    _unlink_all(stage)
    yield from _try_to_open(stage, "no region", must_work=True)


def fill_shm(stage: Any, rng: random.Random) -> Iterator[str]:
    """Open and publish in a small /dev/shm that is full. Yield the faults.

    The /dev/shm belongs to a child process in its own mount namespace, which only root can create.
    """
    if os.geteuid():
        return
    out, into = os.pipe()
    child = _fork(lambda: _in_small(stage, rng, into))
    os.close(into)
    with open(out) as report:
        yield from report.read().splitlines()
    os.waitpid(child, 0)


def _in_small(stage: Any, rng: random.Random, into: int) -> None:
    libc = ctypes.CDLL(None, use_errno=True)
    if libc.unshare(_NEW_NAMESPACE):
        return
    kind = stage.kinds[0]
    size = header_for(kind._type_name_, kind._digest_, ctypes.sizeof(kind), stage.depth).size
    cap = size + 40 * _PAGE
    for command in (["mount", "--make-rprivate", "/"], ["mount", "-t", "tmpfs", "-o", f"size={cap}", "x", "/dev/shm"]):
        if subprocess.run(command, capture_output=True, check=False).returncode:
            return
    filler, file = Path("/dev/shm/filler"), Path(region_file(region_name(stage.topic)))
    for _ in range(10):
        filler.write_bytes(bytes(max(0, cap - rng.randint(0, size // _PAGE + 6) * _PAGE)))
        try:
            with stage.kinds[1](stage.topic, depth=stage.depth) as publisher, suppress(ShmError):
                publisher.publish(stage.sample(publisher.sequence + 1))
        except RegionUnusable as error:
            if file.exists() and file.stat().st_size != size:
                os.write(into, f"full: an open that failed left {file}: {error}\n".encode())
        except BaseException as error:
            os.write(into, f"full: {error!r}\n".encode())
        if stage.program and rng.random() < 0.3:
            os.write(into, "\n".join(_try_to_open_in_cpp(stage, "full", must_work=False)).encode())
        filler.unlink()
        with stage.kinds[1](stage.topic, depth=stage.depth) as publisher:
            publisher.publish(stage.sample(publisher.sequence + 1))
        _unlink_all(stage)


BETWEEN = (truncate_region, place_foreign_file, place_foreign_file, fill_shm)


# --- helpers -------------------------------------------------------------------------------------------------


def _use(stage: Any, pause: float, for_ever: bool = False) -> None:
    with (
        stage.kinds[1](stage.topic, depth=stage.depth) as publisher,
        stage.kinds[2](stage.topic, depth=stage.depth) as subscriber,
    ):
        while True:
            number = publisher.sequence + 1
            publisher.publish(stage.sample(number))
            sample = subscriber.wait(0.0)
            if sample is None or sample.number != number:
                stage.complain(f"after a mishap: sample {number} was published and {sample and sample.number} was read")
            if not for_ever:
                return
            time.sleep(pause)


def _try_to_open(stage: Any, what: str, must_work: bool = False) -> Iterator[str]:
    """Let a child process open publisher and subscriber. Yield a fault if it hangs, crashes or reports no reason.

    If `must_work` is true, a refusal is a fault as well.
    """

    def work() -> None:
        try:
            _use(stage, 0.0)
        except ShmError as error:
            if must_work:
                stage.complain(f"{what}: {error!r}")
        except BaseException as error:
            stage.complain(f"{what}: {error!r}")

    child, end = _fork(work), time.monotonic() + HANGS
    while not (done := os.waitpid(child, os.WNOHANG))[0]:
        if time.monotonic() > end:
            os.kill(child, signal.SIGKILL)
            os.waitpid(child, 0)
            yield f"{what}: opening it hangs"
            return
        time.sleep(0.001)
    if done[1]:
        yield f"{what}: the process that opens it ends with {os.waitstatus_to_exitcode(done[1])}"
    if stage.program:
        yield from _try_to_open_in_cpp(stage, what, must_work)
    if must_work:
        _unlink_all(stage)


def _try_to_open_in_cpp(stage: Any, what: str, must_work: bool) -> Iterator[str]:
    """Let the C++ program open a publisher. Yield a fault if it hangs, crashes or reports no reason."""
    out, into = os.pipe()
    place, end = 3, time.monotonic() + HANGS
    stage.moves[place] = 0
    child = _fork(lambda: stage.become_cpp(place, random.Random(1), "write", into))
    os.close(into)
    while not (done := os.waitpid(child, os.WNOHANG))[0] and not stage.moves[place] and time.monotonic() < end:
        time.sleep(0.001)
    if not done[0]:
        os.kill(child, signal.SIGKILL)
        os.waitpid(child, 0)
    with open(out) as report:
        text = report.read().strip()
    if done[1] or (must_work and not stage.moves[place]) or not (text or stage.moves[place]):
        yield f"{what}: C++ ends with {os.waitstatus_to_exitcode(done[1])} after {stage.moves[place]} samples: {text}"


def _run_tools(stage: Any) -> Iterator[str]:
    """Run the tools on the topic, and yield a fault if one of them crashes."""
    with tempfile.TemporaryDirectory() as folder:
        for command in (
            ["doctor", stage.topic],
            ["top", "--once", "--json", "-d", "0.1"],
            ["clean", stage.topic, "--dry-run"],
        ):
            done = run(command, Path(folder))
            if done.code not in (0, 1) or "SHM901" in done.stderr:
                yield f"{' '.join(command)}: {done.code}, {done.stderr[-300:]!r}"


def _clean_all(stage: Any, known: bool) -> Iterator[str]:
    """Run `shmgen clean`, and yield a fault if it does not remove exactly the files that it should know.

    A file that is too short to be recognized as a region must stay.
    """
    with tempfile.TemporaryDirectory() as folder:
        done = run(["clean", stage.topic], Path(folder))
    if bool(done.code) is known:
        yield f"clean: {done.code} {done.stderr[-300:]!r}"
    _unlink_all(stage)


def _unlink_all(stage: Any) -> None:
    for file in Path("/dev/shm").glob(f"*{region_name(stage.topic)}*"):
        file.unlink(missing_ok=True)


def _fork(work: Callable[[], None]) -> int:
    pid = os.fork()
    if pid == 0:
        try:
            work()
            os._exit(0)
        finally:
            os._exit(1)
    return pid
