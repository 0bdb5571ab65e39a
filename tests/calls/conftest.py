"""Servers and clients in separate processes that end with the test."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import pytest

REPOSITORY = Path(__file__).parents[2]
GENERATED = REPOSITORY / "tests" / "cases" / "service" / "expected" / "python"
sys.path.insert(0, str(GENERATED))

PEER = f"""
import sys, time
sys.path[:0] = [{str(GENERATED)!r}, {str(REPOSITORY)!r}]
from tests.support import machine
machine.pretend()
from shm_service.cell_msgs.srv import *
from shm_service.cell_msgs.action import *

def said(line):
    print(line, flush=True)

"""


class Peer:
    """A process that runs some lines of Python. It prints with `said`, and `hear` reads a printed line."""

    def __init__(self, work: str) -> None:
        self.process = subprocess.Popen(
            [sys.executable, "-c", PEER + work], stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True
        )

    def hear(self) -> str:
        return self.process.stdout.readline().strip()

    def kill(self) -> None:
        self.process.kill()
        self.process.communicate()


@pytest.fixture
def peer():
    """A function that starts a peer and waits until it prints `ready`."""
    processes = []

    def start(work):
        processes.append(Peer(work))
        assert processes[-1].hear() == "ready"
        return processes[-1]

    yield start
    for process in processes:
        process.kill()
