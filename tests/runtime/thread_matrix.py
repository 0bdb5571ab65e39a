"""Run each pair of public calls of a publisher or a subscriber in two threads, while the endpoint loses its region.

python -m tests.runtime.thread_matrix TOPIC STEP [FOLDER WITH THE EXTENSION], where STEP 10 runs every tenth pair
"""

from __future__ import annotations

import asyncio
import itertools
import sys
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import suppress
from pathlib import Path
from typing import Any

import posix_ipc

if len(sys.argv) > 3:
    import shmgen

    shmgen.__path__.insert(0, sys.argv[3])

from shmgen import runtime
from shmgen.runtime import engine, region_name
from shmgen.runtime.region import header as h
from tests.runtime.messages import PosePublisher, PoseSubscriber, pose
from tests.support.region_of import region_of

Call = Callable[[Any], object]
PAUSE = 0.002
PLC = 0xFFFFFFFF


def borrow(end: Any) -> None:
    with end.borrow() as message:
        assert message is None or message.position.x >= 0


def fill(end: Any) -> None:
    with end.loan() as message:
        message.position.x = 1.0


ARGUMENTS: dict[str, Call] = {
    "publish": lambda end: end.publish(pose(1)),
    "loan": fill,
    "borrow": borrow,
    "read_into": lambda end: end.read_into(pose(0)),
    "is_stale": lambda end: end.is_stale(0),
    "ready": lambda end: end.ready(PAUSE),
    "wait": lambda end: end.wait(PAUSE),
    "wait_async": lambda end: asyncio.run(end.wait_async(PAUSE)),
    "ready_async": lambda end: asyncio.run(end.ready_async(PAUSE)),
}
"""The calls that need arguments, or whose result must be used. All other calls are made without arguments."""


def find_calls(kind: type) -> dict[str, Call]:
    """Return the public calls and properties of a class."""

    def make_call(name: str) -> Call:
        if isinstance(getattr(kind, name), property):
            return lambda end: getattr(end, name)
        return lambda end: getattr(end, name)()

    names = [name for name in dir(kind) if not name.startswith("_") and name != "message_type"]
    return {name: ARGUMENTS.get(name) or make_call(name) for name in names}


def remove(topic: str, end: Any) -> None:
    """Remove the file and set `retired`, as `shmgen clean` does."""
    words = region_of(topic).words
    (Path("/dev/shm") / region_name(topic)).unlink()
    words[h.RETIRED] = 1


def claim(topic: str, end: Any) -> None:
    region_of(topic).words[h.WRITER] = PLC


def close(topic: str, end: Any) -> None:
    end.close()


EVENTS = (remove, claim, close)
ROUNDS = {PosePublisher: 5 if engine.IN_C else 1, PoseSubscriber: 1}
"""Attempts per event. Memory that a publisher in C unmaps is often mapped again at once, which hides the fault."""


def repeat(call: Call, end: Any, stop: threading.Event, errors: list[BaseException]) -> None:
    while not stop.is_set():
        try:
            call(end)
        except runtime.ShmError:
            time.sleep(0)
        except BaseException as error:
            errors.append(error)
            return


def run(kind: type, pair: tuple[Call, Call], event: Callable[[str, Any], None], topic: str) -> list[BaseException]:
    """Hold the lock during the event, so that a publisher waits for the lock in the region's memory.

    A subscriber sleeps on the semaphore of a PLC, and accesses that memory again after the wake-up.
    """
    errors: list[BaseException] = []
    stop = threading.Event()
    with (PosePublisher if kind is PoseSubscriber else PoseSubscriber)(topic) as other:
        end = kind(topic, lock_timeout=0.05 if kind is PosePublisher else 0.0)
        threads = [threading.Thread(target=repeat, args=(call, end, stop, errors)) for call in pair]
        if kind is PoseSubscriber:
            other.publish(pose(2))
            region_of(topic).words[h.WRITER] = PLC
        lock = posix_ipc.Semaphore(f"/{region_name(topic)}")
        lock.acquire()
        for thread in threads:
            thread.start()
        time.sleep(PAUSE)
        with suppress(runtime.ShmError):
            event(topic, end)
        lock.release()
        time.sleep(PAUSE)
        stop.set()
        for thread in threads:
            thread.join()
        end.close()
    for file in Path("/dev/shm").glob(f"*{region_name(topic)}*"):
        file.unlink()
    return errors


def pairs() -> Iterator[tuple[type, tuple[str, str]]]:
    for kind in (PosePublisher, PoseSubscriber):
        for pair in itertools.combinations_with_replacement(find_calls(kind), 2):
            yield kind, pair


def main() -> None:
    topic, step = sys.argv[1], int(sys.argv[2])
    assert len(sys.argv) == 3 or engine.engine.__file__.startswith(sys.argv[3])
    count = 0
    for number, (kind, names) in enumerate([*pairs()][::step]):
        calls = find_calls(kind)
        for attempt, event in itertools.product(range(ROUNDS[kind]), EVENTS):
            name = f"{topic}/n{number}_{event.__name__}{attempt}"
            print(kind.__name__, *names, event.__name__, file=sys.stderr)
            errors = run(kind, (calls[names[0]], calls[names[1]]), event, name)
            assert not errors, (kind.__name__, names, event.__name__, errors)
        count += 1
    print(count)


if __name__ == "__main__":
    main()
