"""The files of a topic, and other processes that end with the test."""

from __future__ import annotations

import math
import os
import subprocess
import sys
from contextlib import suppress
from pathlib import Path

import pytest

from shmgen.runtime import engine, region_name
from shmgen.runtime.reference import claim, lock, opening, writer

from ..support import engines, machine
from .messages import WHY_NOT

HERE = Path(__file__).parent


@pytest.fixture
def file(topic):
    return Path("/dev/shm") / region_name(topic)


@pytest.fixture
def semaphore_file(topic):
    return Path("/dev/shm") / f"sem.{region_name(topic)}"


@pytest.fixture
def in_python(monkeypatch):
    """The reference engine in Python, in this process and in processes that the test starts."""
    engines.use_python(monkeypatch)
    monkeypatch.setenv("SHMGEN_PURE", "1")


@pytest.fixture(params=["Python", pytest.param("C", marks=pytest.mark.skipif(not engine.IN_C, reason=WHY_NOT))])
def each_engine(request):
    """Each of the two engines."""
    if request.param == "Python":
        request.getfixturevalue("in_python")
    return request.param


@pytest.fixture
def on_x86(monkeypatch, in_python):
    """A machine like x86, where a call continues without the lock."""
    for module in (lock, writer):
        monkeypatch.setattr(module, "keeps_order", lambda: True)


@pytest.fixture
def on_arm(monkeypatch, in_python):
    """A machine like ARM, where a call needs the lock."""
    for module in (lock, writer):
        monkeypatch.setattr(module, "keeps_order", lambda: False)


@pytest.fixture(autouse=True)
def in_time(monkeypatch):
    """A limit that keeps publishers from skipping numbers if a busy machine pauses them during their opening."""
    monkeypatch.setattr(claim, "_STOOD_STILL", math.inf)


@pytest.fixture(autouse=True)
def with_barrier(monkeypatch):
    """The membarrier(2) of a pretended machine, which does not exist here."""
    if machine.NAME in os.environ:
        monkeypatch.setattr(opening, "has_barrier", lambda: True)


@pytest.fixture
def unhealed(monkeypatch, in_python):
    """A limit that keeps a lock's holder from being considered dead on a slow machine."""
    monkeypatch.setattr(lock, "_STUCK_AFTER", 1e9)


class Other:
    """Another process that executes one of the jobs in messages.py."""

    def __init__(self, *arguments: object) -> None:
        command = [sys.executable, str(HERE / "messages.py"), *map(str, arguments)]
        self.process = subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True)
        assert self.hear() == "ready"

    def tell(self, line: object) -> None:
        self.process.stdin.write(f"{line}\n")
        self.process.stdin.flush()

    def hear(self) -> str:
        return self.process.stdout.readline().strip()

    def ask(self, line: object) -> str:
        self.tell(line)
        return self.hear()

    def kill(self) -> None:
        self.process.kill()
        self.process.wait()

    def end(self) -> None:
        self.process.stdin.close()
        self.process.wait(20 * machine.slower)

    def close(self) -> None:
        self.kill()
        self.process.stdout.close()
        with suppress(BrokenPipeError):
            self.process.stdin.close()


@pytest.fixture
def other():
    others = []

    def start(*arguments):
        others.append(Other(*arguments))
        return others[-1]

    yield start
    for process in others:
        process.close()
