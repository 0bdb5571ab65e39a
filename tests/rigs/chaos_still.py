"""Describes processes of chaos.py that no longer publish or read: state, stack and header of the region."""

from __future__ import annotations

import faulthandler
import os
import re
import signal
import time
from contextlib import suppress
from pathlib import Path
from typing import Any

import posix_ipc

from shmgen.runtime import ShmError, read_header, region_name
from shmgen.runtime.region.names import event_name

_WORDS = (
    "writer",
    "completed0",
    "completed1",
    "turn",
    "left",
    "heartbeat",
    "lock_holder",
    "lock_count",
    "recoveries",
    "armed",
    "missed",
    "bell",
)


def dump_stack_on_signal(stage: Any) -> None:
    """Let this process write its stack to a file when it receives SIGUSR2."""
    faulthandler.register(signal.SIGUSR2, file=stage.stacks, all_threads=False)


class Surplus:
    """Detects that the lock has more than one token, so that two processes could hold it at a time.

    A surplus exists only if each check so far has found more than one token.
    """

    def __init__(self, stage: Any) -> None:
        """Open the lock of the topic. Without `stage`, no process removes tokens, so there is nothing to check."""
        self._lock: posix_ipc.Semaphore | None = None
        with suppress(posix_ipc.ExistentialError):
            self._lock = posix_ipc.Semaphore(f"/{region_name(stage.topic)}") if stage else None

    def is_there(self) -> bool:
        if self._lock and self._lock.value <= 1:
            self._lock.close()
            self._lock = None
        return self._lock is not None


def describe(stage: Any, cast: list[Any], before: list[int]) -> str:
    """Return a text about all processes. A process that continues may block another, so all are listed."""
    lines = [_describe_actor(actor, moves) for actor, moves in zip(cast, before, strict=True)]
    return "\n  ".join([_describe_region(stage), *lines])


def report_claim_holder(stage: Any, error: Exception) -> None:
    """Report a fault with the stack and the state of the process that still holds the claim."""
    match = re.search(r"process (\d+)", str(error))
    stack = _stack(stage, int(match[1])) if match else "?"
    status = Path(f"/proc/{match[1]}/status").read_text() if match else ""
    stage.complain(f"{error!r}: {stack}; {re.findall(r'(?:State|PPid|Sig...|voluntary.*):.*', status)}")


def _describe_actor(actor: Any, before: int) -> str:
    text = f"{actor.work.__name__}, process {actor.pid} ({actor.state()}), {actor.moves - before} samples since"
    if actor.interpreted:
        text += f": {_stack(actor.stage, actor.pid)}"
    return text


def _stack(stage: Any, pid: int) -> str:
    """Return the innermost frames of a process, which has a quarter of a second to write them."""
    stacks, start = stage.stacks, os.lseek(stage.stacks, 0, os.SEEK_END)
    with suppress(ProcessLookupError):
        os.kill(pid, signal.SIGUSR2)
    end = time.monotonic() + 0.25
    while os.fstat(stacks).st_size == start and time.monotonic() < end:
        time.sleep(0.001)
    time.sleep(0.01)
    frames = os.pread(stacks, 4000, start).decode(errors="replace").splitlines()[1:9]
    return " < ".join(frame.strip().replace(str(Path.cwd()), "") for frame in frames) or "does not answer"


def _describe_region(stage: Any) -> str:
    name = region_name(stage.topic)
    try:
        header = read_header(name)._asdict()
    except ShmError as error:
        return repr(error)
    values = {}
    for semaphore in (name, event_name(name)):
        with suppress(posix_ipc.ExistentialError):
            opened = posix_ipc.Semaphore(f"/{semaphore}")
            values[semaphore.rpartition("-")[2] if "-event" in semaphore else "lock"] = opened.value
            opened.close()
    words = {word: header[word] for word in _WORDS}
    return f"{stage.kind}, depth {stage.depth}: {words}, semaphores {values}"
