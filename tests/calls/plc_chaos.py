"""Thousands of calls with a PLC at one end or both, killed meanwhile, from a seed.

    python -m tests.calls.plc_chaos --calls 10000 --seed 1 [--scenes plc_serves plc_asks plc_alone] [--fault NAME]

One server and one client, each killed at random instants and started again at once; now and then both are killed and
the regions removed, so that their making is met as well. The PLC is the generated Structured Text in the tests' soft
PLC, in a process of its own. The answer is a function of the question; the server tells the number of each call before
it serves it. `--fault` takes a block with a fault (tests/support/plc_calls.py), which must be found.
"""

from __future__ import annotations

import argparse
import os
import random
import signal
import struct
import sys
import tempfile
import time
import uuid
from collections import Counter
from collections.abc import Callable
from contextlib import suppress
from dataclasses import dataclass, field
from pathlib import Path
from types import ModuleType, SimpleNamespace
from typing import Any, NamedTuple, TypeAlias

from shmgen import runtime
from shmgen.core.model import TypeName
from tests.support.build import module
from tests.support.plc_calls import FAULTS, PACKAGE, Calls, open_or_make

SLACK = 0.5
"""Seconds that a call may last beyond its time, on a machine with much else to do."""
CYCLE = 0.0002
"""Seconds."""
_ENTRY = struct.Struct("<cI")


@dataclass
class Verdict:
    """`ends` counts how calls ended: reply, failed, timeout, no server, cancelled, error of a region."""

    ends: Counter[str] = field(default_factory=Counter)
    kills: Counter[str] = field(default_factory=Counter)
    complaints: list[str] = field(default_factory=list)
    served: int = 0


@dataclass
class Stage:
    """What all processes share; `fault` is the ending of a faulty block's name."""

    calls: Calls
    srv: ModuleType
    service: str
    told: int
    client_fault: str = ""
    server_fault: str = ""

    def tell(self, kind: bytes, value: int) -> None:
        os.write(self.told, _ENTRY.pack(kind, value))


def serve(stage: Stage, dice: random.Random) -> None:
    """In Python."""
    old = _newest_call(stage)
    server = stage.srv.AskServer(stage.service)
    while True:
        call = server.wait(1.0)
        if call is None:
            continue
        stage.tell(b"s" if call.number > old else b"o", call.number)
        time.sleep(call.request.cycles * CYCLE)
        if call.request.fail:
            server.fail(call)
        else:
            answer = _answer(call.request.question)
            server.reply(call, SimpleNamespace(answer=answer, copies=[answer] * 16))


def plc_serve(stage: Stage, dice: random.Random) -> None:
    server = stage.calls.server(stage.service, stage.server_fault)
    job = stage.calls.plc.block("FB_Answer")
    old = _newest_call(stage)
    while True:
        if server.xBusy:  # not open yet: what comes until then is old too
            old = _newest_call(stage)
        before = server.xExecute
        server(xDone=job.xDone, xFailed=job.xError)
        if server.xExecute and not before:
            stage.tell(b"s" if server.udiCall > old else b"o", server.udiCall)
            job.Request.question, job.Request.cycles = server.Request.question, server.Request.cycles
            job.Request.fail = server.Request.fail
        job(xExecute=server.xExecute)
        if job.xDone:
            server.Response.answer = job.Response.answer
            for index in range(16):
                server.Response.copies[index] = job.Response.copies[index]
        time.sleep(CYCLE)


def ask(stage: Stage, dice: random.Random) -> None:
    """In Python: waits for a server before it sends, or sends whether there is one or not."""
    client = stage.srv.AskClient(stage.service)
    while True:
        question, timeout, begin = _ask(dice)
        request = SimpleNamespace(question=question, cycles=_cycles(dice), fail=dice.random() < 0.05)
        kind = b"t"
        with suppress(runtime.CallTimeout):
            try:
                response = client.call(request, timeout) if dice.random() < 0.6 else _poll(client, request, timeout)
                kind = b"r" if _is_own(response, question) else b"w"
            except runtime.CallFailed:
                kind = b"f"
            except runtime.NoServer:
                kind = b"n"
        _ended(stage, kind, question, begin, timeout)
        time.sleep(dice.uniform(0.0, 0.002))


def plc_ask(stage: Stage, dice: random.Random) -> None:
    client = stage.calls.client(stage.service, stage.client_fault)()
    while True:
        question, timeout, begin = _ask(dice)
        request, cancel = client.Request, dice.random() < 0.1
        request.question, request.cycles, request.fail = question, _cycles(dice), dice.random() < 0.05
        client(xExecute=True, tTimeout=int(timeout * 1000), xCancel=False)
        while client.xBusy:
            time.sleep(CYCLE)
            client(xCancel=cancel and client.udiCall != 0 and dice.random() < 0.1)
        if client.xDone:
            kind = b"r" if _is_own(client.Response, question) else b"w"
        elif client.xAborted:
            kind = b"c"
        else:
            kind = {"CALL_FAILED": b"f", "CALL_TIMEOUT": b"t"}.get(client.eErrorID, b"e")
        _ended(stage, kind, question, begin, timeout)
        client(xExecute=False)


Work: TypeAlias = Callable[[Stage, random.Random], None]


class Scene(NamedTuple):
    """`hits` are drawn from; a PLC that was killed is back in a second, which is the time others watch for it."""

    works: tuple[Work, Work]
    hits: tuple[tuple[int, ...], ...]
    pause: float


SCENES = {
    "plc_serves": Scene((plc_serve, ask), ((0,), (1,), (1,), (1,), (1,), (0, 1)), 0.5),
    "plc_asks": Scene((serve, plc_ask), ((0,), (0,), (0,), (0,), (1,), (0, 1)), 0.5),
    "plc_alone": Scene((plc_serve, plc_ask), ((0,), (1,), (0, 1)), 2.0),
}
"""Server and client; who is hit; how long no one is at most, in seconds."""


def run(folder: Path, scene: str, number: int, seed: int, fault: str = "", longest: float = 600.0) -> Verdict:
    """`number` calls, or those of `longest` seconds."""
    dice, verdict = random.Random(seed), Verdict()
    reader, writer = os.pipe2(os.O_CLOEXEC)
    os.set_blocking(reader, False)
    calls = open_or_make(folder)
    srv = module(calls.folder, PACKAGE, TypeName("calls_msgs", "srv", "Ask"))
    stage = Stage(calls, srv, f"/shmgen_test/t{uuid.uuid4().hex}", writer)
    if fault and FAULTS[fault][0] == "FB_ShmClient":
        stage.client_fault = f"_{fault}"
    elif fault:
        stage.server_fault = f"_{fault}"
    works, hits, pause = SCENES[scene]
    children = [_child(work, stage, dice.random()) for work in works]
    end, due = time.monotonic() + longest, 0.0
    try:
        while sum(verdict.ends.values()) < number and time.monotonic() < end and not verdict.complaints:
            due = due or time.monotonic() + dice.uniform(0.02, pause)
            time.sleep(0.005)
            _listen(reader, verdict)
            if time.monotonic() > due:
                due = 0.0
                hit = dice.choice(hits)
                for place in hit:
                    _kill(children[place])
                    verdict.kills[works[place].__name__] += 1
                if len(hit) == 2:
                    _listen(reader, verdict)
                    _remove(stage)
                    verdict.served = 0
                for place in hit:
                    children[place] = _child(works[place], stage, dice.random())
    finally:
        for pid in children:
            _kill(pid)
        _listen(reader, verdict)
        os.close(reader)
        os.close(writer)
        _remove(stage)
    return verdict


def _newest_call(stage: Stage) -> int:
    """What is there when a server starts is old."""
    with suppress(runtime.RegionMissing):
        return runtime.read_header(f"{runtime.region_name(stage.service)}-request").newest
    return 0


def _ask(dice: random.Random) -> tuple[int, float, float]:
    """A question nobody asked before, its time limit in seconds, and now."""
    return dice.getrandbits(60), dice.choice((0.003, 0.03, 0.3)), time.monotonic()


def _cycles(dice: random.Random) -> int:
    return dice.choice((0, 0, 0, 1, 3, 10, 30))


def _poll(client: Any, request: Any, timeout: float) -> Any:
    client.send(request)
    end = time.monotonic() + timeout
    while time.monotonic() < end:
        if response := client.poll():
            return response
        time.sleep(CYCLE)
    client.cancel()
    raise runtime.CallTimeout


def _answer(question: int) -> int:
    return 3 * question + 1


def _is_own(response: Any, question: int) -> bool:
    return bool(response.answer == _answer(question)) and all(copy == response.answer for copy in response.copies)


def _ended(stage: Stage, kind: bytes, question: int, begin: float, timeout: float) -> None:
    late = time.monotonic() - begin - timeout
    if late > SLACK:
        stage.tell(b"l", int(late * 1000))
    stage.tell(kind, question & 0xFFFFFFFF)


def _listen(reader: int, verdict: Verdict) -> None:
    with suppress(BlockingIOError):
        while data := os.read(reader, 1000 * _ENTRY.size):
            for kind, value in _ENTRY.iter_unpack(data):
                if kind == b"s":
                    if value <= verdict.served:
                        verdict.complaints.append(f"call {value} was served after call {verdict.served}")
                    verdict.served = value
                elif kind == b"w":
                    verdict.complaints.append(f"question {value:08X} got the answer to another")
                elif kind == b"o":
                    verdict.complaints.append(f"call {value} was there before the server that served it")
                elif kind == b"l":
                    verdict.complaints.append(f"a call lasted {value} ms too long")
                else:
                    verdict.ends[kind.decode()] += 1


def _child(work: Work, stage: Stage, seed: float) -> int:
    pid = os.fork()
    if pid:
        return pid
    try:
        work(stage, random.Random(seed))
    except BaseException as error:
        print(f"{work.__name__}: {error!r}", file=sys.stderr)
    finally:
        os._exit(1)


def _kill(pid: int) -> None:
    os.kill(pid, signal.SIGKILL)
    os.waitpid(pid, 0)


def _remove(stage: Stage) -> None:
    for file in Path("/dev/shm").glob(f"*{stage.service[1:].replace('/', '.')}*"):
        file.unlink()


def main() -> None:
    """Exit code 1 if a fault was found."""
    parser = argparse.ArgumentParser(description="Kills a PLC and its peer while one calls the other.")
    parser.add_argument("--calls", type=int, default=10_000)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--seconds", type=float, default=600.0)
    parser.add_argument("--scenes", nargs="*", choices=SCENES, default=list(SCENES))
    parser.add_argument("--fault", choices=("", *FAULTS), default="")
    given = parser.parse_args()
    found = False
    with tempfile.TemporaryDirectory(prefix="shmgen-chaos") as folder:
        open_or_make(Path(folder))
        for scene in given.scenes:
            begin = time.monotonic()
            verdict = run(Path(folder), scene, given.calls, given.seed, given.fault, given.seconds)
            took = f"{time.monotonic() - begin:.0f} s"
            print(f"seed {given.seed}, {scene}: {verdict.ends.total()} calls {dict(verdict.ends)} in {took}")
            print(f"  kills {dict(verdict.kills)}", flush=True)
            print(
                "\n".join(verdict.complaints[:20])
                or "  every call ended, none in the answer to another, none served twice"
            )
            found |= bool(verdict.complaints)
    sys.exit(found)


if __name__ == "__main__":
    main()
