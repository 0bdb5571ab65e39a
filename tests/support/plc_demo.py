"""A demo message for both sides, generated and compiled for the PLC, and access to its region."""

from __future__ import annotations

import mmap
import os
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from types import ModuleType
from typing import Any, ClassVar

import posix_ipc

from shmgen.config import Config
from shmgen.core.model import Layouts
from shmgen.generator import pipeline
from shmgen.runtime.region import header
from shmgen.runtime.region.names import region_file, region_name
from tests.softplc import Block, Plc, compile_st

from .build import module, put

PACKAGE = "shm_plc_demo"
MESSAGES = {
    "Inner": "int16 k 7\nfloat64 v 1.25\n",
    "Demo": 'uint32 a\nstring<=9 label "hey"\nInner inner\nint32[<=3] tail\nuint32 b\n',
    "Other": "uint32 a\nuint32 b\n",
}


SLOTS = 2
"""The number of slots of a topic with depth 1."""
RETRY, CLAIM, CONFIRM, HEAL = 500, 1000, 100, 1000
"""The times in ms after which blocks retry to open, claim a topic, confirm a claim, and recover a lock."""


@dataclass(frozen=True)
class Demo:
    """The compiled PLC. `python` has Demo, DemoPublisher and DemoSubscriber. Other processes load `library`."""

    texts: Mapping[str, str]
    python: ModuleType
    plc: Plc
    library: Path

    def publisher(self, topic: str, **inputs: Any) -> Block:
        return self._block("FB_demo_msgs_Demo_Publisher", topic, inputs)

    def opened(self, topic: str, after: int = 0, **inputs: Any) -> Block:
        """Return a publisher that has watched its topic for `after` ms, claimed it, and sent a first sample."""
        return ready(self.publisher(topic, **inputs), after)

    def subscriber(self, topic: str, **inputs: Any) -> Block:
        return self._block("FB_demo_msgs_Demo_Subscriber", topic, inputs)

    def message(self, a: int) -> Any:
        """Return a message whose fields show if it mixes two samples."""
        return self.python.Demo(a=a, b=2 * a, label=f"x{a % 1000}", tail=[a, -a])

    def _block(self, name: str, topic: str, inputs: dict[str, Any]) -> Block:
        block = self.plc.block(name)
        for name, value in {"xEnable": True, "sTopic": topic, **inputs}.items():
            setattr(block, name, value)
        return block


def ready(block: Block, after: int = 0) -> Block:
    """Call a block at earlier times, so that its claim is confirmed now."""
    now = block.plc.now
    for before in (after + CONFIRM, CONFIRM):
        block.plc.set_clock((now - before) % 2**32)
        for _ in range(3):  # a region, the one behind it, and the claim
            block()
    block.plc.set_clock(now)
    return block()


def take_over(block: Block) -> None:
    """Advance the clock until the block has taken the topic over from a dead writer."""
    for ms in (CLAIM, CONFIRM):
        block.plc.set_clock((block.plc.now + ms) % 2**32)
        if ms == CLAIM:
            block()


def make(folder: Path) -> Demo:
    """Generate, compile and load the demo."""
    texts, layouts = generated(folder, "demo_msgs/Demo", "demo_msgs/Other")
    plc = compile_st({path: text for path, text in texts.items() if path.endswith(".st")}, folder / "plc")
    return Demo(texts, module(folder, PACKAGE, next(iter(layouts))), plc, folder / "plc" / "plc.so")


def generated(folder: Path, *messages: str) -> tuple[dict[str, str], Layouts]:
    """Generate messages. Return all files and the layouts, and write the Python files into `folder`."""
    put({f"demo_msgs/msg/{name}.msg": text for name, text in MESSAGES.items()}, folder)
    config = Config(folder, source="jazzy", path=(folder,), package=PACKAGE)
    texts = pipeline.generate(config, messages)
    put({path: text for path, text in texts.items() if path.startswith("python/")}, folder)
    return texts, pipeline.lay_out(config, messages)


class Clock:
    """The PLC's clock, which starts shortly before it wraps around."""

    def __init__(self, plc: Plc) -> None:
        self._plc, self._now = plc, 2**32 - 700
        self.add(0)

    def add(self, ms: int) -> None:
        self._now = (self._now + ms) % 2**32
        self._plc.set_clock(self._now)


def semaphore(topic: str, suffix: str = "") -> posix_ipc.Semaphore:
    return posix_ipc.Semaphore(f"/{region_name(topic)}{suffix}")


class Memory:
    """The bytes of a topic's region, with the header fields as attributes."""

    WORDS: ClassVar = {
        "magic": 0, "slots": 7, "writer": header.WRITER, "heartbeat": header.HEARTBEAT,
        "retired": header.RETIRED, "ordered": header.ORDERED,
        "completed0": header.COMPLETED0, "completed1": header.COMPLETED1, "lock_holder": header.LOCK_HOLDER,
        "recoveries": 40, "armed": 41, "lock_count": header.LOCK_COUNT, "missed": header.MISSED,
    }  # fmt: skip

    def __init__(self, topic: str, suffix: str = "") -> None:
        file = os.open(region_file(region_name(topic) + suffix), os.O_RDWR)
        self._map = mmap.mmap(file, 0)
        os.close(file)
        self._words = memoryview(self._map).cast("I")

    def __getitem__(self, name: str) -> int:
        return self._words[self.WORDS[name]]

    def __setitem__(self, name: str, value: int) -> None:
        self._words[self.WORDS[name]] = value

    @property
    def newest(self) -> int:
        return header.later(self["completed0"], self["completed1"])

    def poke(self, offset: int, data: bytes) -> None:
        self._map[offset : offset + len(data)] = data

    def bytes(self) -> bytes:
        return self._map[:]
