"""A reader gets the newest complete sample after a writer was killed at any instruction of publish."""

from __future__ import annotations

import ctypes
import itertools
import os
from collections.abc import Callable
from pathlib import Path

import pytest

from .support import steps
from .support.plc_demo import Demo, take_over
from .test_never_waits import compile_library

pytestmark = pytest.mark.slow


def kill_at_each_instruction(demo: Demo, topic: str, publish: Callable[[int, int], None], stride: int) -> int:
    """Call `publish(number, instruction)` in a new process for each `stride`. Return the number of processes."""
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
            newest = subscriber.read()
        assert newest or not before, f"nothing, killed behind {instruction}"
        if newest:
            assert (newest.a in (before, number), newest.b) == (True, 2 * newest.a), f"killed behind {instruction}"
            before = newest.a
        if ended == 0:
            assert before == number
            return number
    raise AssertionError


EARLY = """
    shmgen_store(&self->end, shmgen_slot_of(&self->end, self->number, 0) + offsetof(shmgen_slot, number), self->number);
    shmgen_store(&self->end, shmgen_completed(0), self->number);"""
"""A fault: the writer marks the sample as complete before it copies the bytes."""


@pytest.mark.sample("[-c]")
@pytest.mark.parametrize("language", ["c", "cpp"])
@pytest.mark.parametrize("fault", ["", EARLY], ids=["", "planted"])
def test_sample_survives_a_killed_c_writer(demo: Demo, tmp_path: Path, topic: str, language: str, fault: str) -> None:
    library = compile_library(tmp_path, fault)

    def publish(number: int, instruction: int) -> None:
        getattr(library, f"{language}_open")(topic.encode())
        getattr(library, f"{language}_set_message")(ctypes.c_uint32(number))
        steps.killed_at(instruction, getattr(library, f"{language}_try_publish"))

    steps.counted(steps._counter().nothing)  # skips if this machine cannot count instructions
    if fault:
        with pytest.raises(AssertionError, match="killed behind"):
            kill_at_each_instruction(demo, topic, publish, 1)
    else:
        assert kill_at_each_instruction(demo, topic, publish, 1) > 200


def test_sample_survives_a_killed_plc(demo: Demo, topic: str) -> None:
    """Stop at every 29th instruction, because translated code is long. Each PLC takes the topic over from the last."""

    def publish(number: int, instruction: int) -> None:
        block = demo.publisher(topic)()
        take_over(block)
        block()
        block.Msg.a, block.Msg.b, block.xSend = number, 2 * number, True
        steps.killed_at(instruction, demo.plc._calls[block._name, ""], block._address)

    steps.counted(steps._counter().nothing)  # skips if this machine cannot count instructions
    assert kill_at_each_instruction(demo, topic, publish, 29) > 100
