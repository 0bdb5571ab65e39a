"""The command in a separate folder, and processes that use a region."""

from __future__ import annotations

import subprocess
import sys
import threading
from pathlib import Path

import pytest

from shmgen.runtime import region_name

from ..support.command import run

REPOSITORY = Path(__file__).parents[2]

PEER = """
import os, sys
sys.path.insert(0, {repository!r})
from tests.runtime.messages import PosePublisher, PoseSubscriber, pose
from tests.support.region_of import region_of
from shmgen.runtime.region import header as h
{work}
print("ready", flush=True)
sys.stdin.read()
"""


@pytest.fixture
def shmgen(tmp_path):
    """A function that runs `shmgen arguments…` in an empty folder, in this process."""
    return lambda *arguments: run([str(argument) for argument in arguments], tmp_path)


@pytest.fixture
def started(tmp_path):
    """A function that starts `shmgen arguments…` in the same folder as a process that ends with the test."""
    processes, limits = [], []

    def start(*arguments):
        command = [sys.executable, "-m", "shmgen", *map(str, arguments)]
        processes.append(
            subprocess.Popen(command, cwd=tmp_path, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True)
        )
        limits.append(threading.Timer(30, processes[-1].kill))  # so that what never comes is a failure, not a hang
        limits[-1].start()
        return processes[-1]

    yield start
    for process, limit in zip(processes, limits, strict=True):
        limit.cancel()
        process.kill()
        process.communicate()


@pytest.fixture
def peer():
    """A function that starts a process. It runs some lines of Python and then waits with its endpoints open."""
    processes = []

    def start(work, *before):
        code = PEER.format(repository=str(REPOSITORY), work=work)
        processes.append(
            subprocess.Popen(
                [*before, sys.executable, "-c", code], stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True
            )
        )
        assert processes[-1].stdout.readline() == "ready\n"
        return processes[-1]

    yield start
    for process in processes:
        process.kill()
        process.communicate()


@pytest.fixture
def file(topic):
    return Path("/dev/shm") / region_name(topic)


@pytest.fixture
def semaphore(topic):
    return Path("/dev/shm") / f"sem.{region_name(topic)}"
