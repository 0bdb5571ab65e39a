"""A recorder in a thread of this process, and a message with all kinds of fields."""

from __future__ import annotations

import threading
import time
from contextlib import contextmanager
from pathlib import Path

import pytest

from shmgen.bag.folder import Bag
from shmgen.bag.record import Recorder
from shmgen.config import Config
from shmgen.live.classes import ClassRegistry
from shmgen.live.session import Session

from ..support.command import run

DEFINITION = """
uint8 LEVEL=3
string WORD="a b"
bool[3] flags
int8 small
time at
duration[<=3] pauses
string<=20 name
string<=5[<=3] words
float64[] numbers
geometry_msgs/Point[<=2] points
std_msgs/Empty nothing
uint8 last
"""


def wait_for(condition):
    """Wait until a condition is true, for 30 s at most."""
    ends = time.monotonic() + 30
    while not condition():
        assert time.monotonic() < ends
        time.sleep(0.001)


@pytest.fixture
def registry(tmp_path):
    """A registry with demo_msgs/Full, which has all kinds of fields."""
    file = tmp_path / "msgs" / "demo_msgs" / "msg" / "Full.msg"
    file.parent.mkdir(parents=True)
    file.write_text(DEFINITION)
    (tmp_path / "shmgen.toml").write_text('path = ["msgs"]\n[bounds]\n"demo_msgs/Full.numbers" = 6\n')
    return shop(tmp_path)


def shop(folder: Path) -> ClassRegistry:
    from shmgen.config import load
    from shmgen.core.diagnostics import Report

    file = folder / "shmgen.toml"
    return ClassRegistry(Session(load(file, "shmgen.toml", Report()) if file.exists() else Config(folder)), None)


@pytest.fixture
def shmgen(tmp_path):
    """A function that runs `shmgen arguments...` in the folder of the registry."""
    return lambda *arguments: run([str(argument) for argument in arguments], tmp_path)


@pytest.fixture
def recording(tmp_path, registry):
    """A context manager that records topics into tmp_path/bag and yields the recorder."""

    @contextmanager
    def record(*topics, count=None, name="bag", **limits):
        logged: list[str] = []
        bag = Bag(tmp_path / name, **limits)
        recorder, stopping = Recorder(registry, bag, topics, logged.append), threading.Event()
        recorder.logged = logged
        thread = threading.Thread(target=recorder.run, args=[stopping])
        thread.start()
        try:
            wait_for(lambda: recorder.figures.topics == (len(topics) if count is None else count))
            yield recorder
            time.sleep(0.01)  # the last look is taken after it anyway
        finally:
            stopping.set()
            thread.join(20)
        assert not thread.is_alive()

    return record
