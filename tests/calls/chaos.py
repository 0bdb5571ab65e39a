"""Thousands of calls between processes that are killed meanwhile, from a seed, and what must hold all the same.

    python -m tests.calls.chaos --calls 10000 --seed 1 [--fault client|server]

One server and one client, each killed at random instants and started again at once. The response carries a function of
the request; the server tells the number of each call before it serves it. `--fault` leaves out one check of the
runtime, which must be found.
"""

from __future__ import annotations

import argparse
import os
import random
import signal
import struct
import sys
import time
import uuid
from collections import Counter
from contextlib import suppress
from dataclasses import dataclass, field
from pathlib import Path
from types import SimpleNamespace
from typing import Any

from shmgen import runtime
from shmgen.runtime import calls

from .conftest import GENERATED

SLACK = 0.5
"""Seconds that a call may last beyond its time, on a machine with much else to do."""
LONGEST = 60.0
SLOW = 0.02
"""Of so many calls the server takes up to 20 ms, for which some clients do not wait."""
_ENTRY = struct.Struct("<cI")


@dataclass
class Verdict:
    """`ends` counts how calls ended: reply, failed, timeout, no server; `served` the numbers the server told."""

    ends: Counter[str] = field(default_factory=Counter)
    kills: int = 0
    complaints: list[str] = field(default_factory=list)


def run(number: int, seed: int, fault: str = "", longest: float = LONGEST) -> Verdict:
    """`number` calls, or those of `longest` seconds."""
    dice = random.Random(seed)
    topic = f"/shmgen_test/chaos{uuid.uuid4().hex}"
    reader, writer = os.pipe2(os.O_CLOEXEC)
    os.set_blocking(reader, False)
    verdict, numbers = Verdict(), _Numbers()
    children = {work: _child(work, topic, writer, dice.random(), fault) for work in (_serve, _call)}
    end, due = time.monotonic() + longest, 0.0
    try:
        while sum(verdict.ends.values()) < number and time.monotonic() < end:
            due = due or time.monotonic() + dice.uniform(0.02, 0.1)
            time.sleep(0.005)
            _listen(reader, verdict, numbers)
            if time.monotonic() > due:
                due = 0.0
                work = dice.choice((_serve, _serve, _call))
                _kill(children[work])
                verdict.kills += 1
                children[work] = _child(work, topic, writer, dice.random(), fault)
    finally:
        for pid in children.values():
            _kill(pid)
        _listen(reader, verdict, numbers)
        os.close(reader)
        os.close(writer)
        for file in Path("/dev/shm").glob(f"*{topic[1:].replace('/', '.')}*"):
            file.unlink()
    return verdict


class _Numbers:
    """The numbers of calls that servers told: each greater than the one before."""

    last = 0


def _listen(reader: int, verdict: Verdict, numbers: _Numbers) -> None:
    with suppress(BlockingIOError):
        while data := os.read(reader, 1000 * _ENTRY.size):
            for kind, value in _ENTRY.iter_unpack(data):
                if kind == b"s":
                    if value <= numbers.last:
                        verdict.complaints.append(f"call {value} was served after call {numbers.last}")
                    numbers.last = value
                elif kind == b"w":
                    verdict.complaints.append(f"call with batch {value} got the reply of another")
                elif kind == b"l":
                    verdict.complaints.append(f"a call lasted {value} ms too long")
                else:
                    verdict.ends[kind.decode()] += 1


def _child(work: Any, topic: str, writer: int, seed: float, fault: str) -> int:
    pid = os.fork()
    if pid:
        return pid
    try:
        _plant(fault)
        work(topic, writer, random.Random(seed))
    except BaseException as error:
        print(f"{work.__name__}: {error!r}", file=sys.stderr)
    finally:
        os._exit(1)


def _kill(pid: int) -> None:
    os.kill(pid, signal.SIGKILL)
    os.waitpid(pid, 0)


def _serve(topic: str, writer: int, dice: random.Random) -> None:
    server = _opened("StartServer", topic)
    while True:
        call = server.wait(1.0)
        if call is None:
            continue
        os.write(writer, _ENTRY.pack(b"s", call.number))
        chance = dice.random()
        if chance < SLOW:
            time.sleep(dice.uniform(0.0, 0.02))
        if chance > 0.95:
            server.fail(call)
        else:
            server.reply(call, SimpleNamespace(success=True, batch=_answer(call.request.batch), message=""))


def _call(topic: str, writer: int, dice: random.Random) -> None:
    client = _opened("StartClient", topic)
    while True:
        batch = dice.getrandbits(32)
        timeout = dice.choice((0.002, 0.02, 0.2))
        begin = time.monotonic()
        kind, value = b"r", batch
        try:
            response = client.call(SimpleNamespace(on=True, batch=batch), timeout)
            if response.batch != _answer(batch):
                kind = b"w"
        except runtime.CallFailed:
            kind = b"f"
        except runtime.NoServer:
            kind = b"n"
        except runtime.CallTimeout:
            kind = b"t"
        late = time.monotonic() - begin - timeout
        if late > SLACK:
            kind, value = b"l", int(late * 1e3)
        os.write(writer, _ENTRY.pack(kind, value))


def _answer(batch: int) -> int:
    return batch * 2654435761 & 0xFFFFFFFF


def _opened(name: str, topic: str) -> Any:
    if str(GENERATED) not in sys.path:
        sys.path.insert(0, str(GENERATED))
    from shm_service.cell_msgs import srv  # type: ignore[import-not-found]

    return getattr(srv, name)(topic)


def _plant(fault: str) -> None:
    """Leaves one check out: the client takes whatever comes, or the server whatever lies there."""
    global SLOW
    if fault == "client":
        SLOW = 0.5

        def own(client: Any, response: Any) -> Any:
            if response is not None:
                client.number = 0
            return response

        calls.CallClient._own = own  # type: ignore[method-assign]
    elif fault == "server":
        from shmgen.runtime import server

        server.skip_stale = lambda questions: questions  # type: ignore[attr-defined]


def main() -> None:
    parser = argparse.ArgumentParser()
    parser.add_argument("--calls", type=int, default=10_000)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--fault", choices=("", "client", "server"), default="")
    given = parser.parse_args()
    begin = time.monotonic()
    verdict = run(given.calls, given.seed, given.fault)
    print(f"{dict(verdict.ends)}, {verdict.kills} kills, {time.monotonic() - begin:.1f} s")
    print(*verdict.complaints[:20], sep="\n")
    sys.exit(1 if verdict.complaints else 0)


if __name__ == "__main__":
    main()
