"""A writer killed behind each instruction of a publish: what a new reader finds is whole, and the newest."""

from __future__ import annotations

import ctypes
import itertools
import os
from collections.abc import Callable
from pathlib import Path

import pytest

from .support import steps
from .support.plc_demo import Demo, take_over
from .test_never_waits import compiled

pytestmark = pytest.mark.slow


def survives(demo: Demo, topic: str, publish: Callable[[int, int], None], stride: int) -> int:
    """`publish(number, instruction)` in a process of its own for each `stride`; returns how many there were."""
    before = 0
    for number in itertools.count(1):
        instruction = 1 + stride * (number - 1)
        pid = os.fork()
        if pid == 0:
            try:
                publish(number, instruction)
            finally:
                os._exit(0)
        ended = os.waitstatus_to_exitcode(os.waitpid(pid, 0)[1])
        with demo.python.DemoSubscriber(topic) as subscriber:
            found = subscriber.read()
        assert found or not before, f"nothing, killed behind {instruction}"
        if found:
            assert (found.a in (before, number), found.b) == (True, 2 * found.a), f"killed behind {instruction}"
            before = found.a
        if ended == 0:
            assert before == number
            return number
    raise AssertionError


EARLY = """
    shmgen_store(&self->end, shmgen_slot_of(&self->end, self->number, 0) + offsetof(shmgen_slot, number), self->number);
    shmgen_store(&self->end, shmgen_completed(0), self->number);"""
"""A fault: the sample is complete before its bytes are there."""


@pytest.mark.parametrize("language", ["c", "cpp"])
@pytest.mark.parametrize("fault", ["", EARLY], ids=["", "planted"])
def test_in_c(demo: Demo, tmp_path: Path, topic: str, language: str, fault: str) -> None:
    library = compiled(tmp_path, fault)

    def publish(number: int, instruction: int) -> None:
        getattr(library, f"{language}_open")(topic.encode())
        getattr(library, f"{language}_say")(ctypes.c_uint32(number))
        steps.killed_at(instruction, getattr(library, f"{language}_try_publish"))

    steps.counted(steps._counter().nothing)  # skips where that cannot be had
    if fault:
        with pytest.raises(AssertionError, match="killed behind"):
            survives(demo, topic, publish, 1)
    else:
        assert survives(demo, topic, publish, 1) > 200


def test_in_a_plc(demo: Demo, topic: str) -> None:
    """Translated and not optimised, so in strides; each takes the topic over from one that stands still."""

    def publish(number: int, instruction: int) -> None:
        block = demo.publisher(topic)()
        take_over(block)
        block()
        block.Msg.a, block.Msg.b, block.xSend = number, 2 * number, True
        steps.killed_at(instruction, demo.plc._calls[block._name, ""], block._address)

    steps.counted(steps._counter().nothing)  # skips where that cannot be had
    assert survives(demo, topic, publish, 29) > 100
