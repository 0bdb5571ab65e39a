"""Thousands of calls and goals between a client and a server that are killed and updated meanwhile, from a seed.

    python -m tests.calls.chaos --calls 10000 --seed 1 [--scenes python_alone plc_serves ...] [--fault NAME]

One server and one client, in Python or a PLC, are killed at random instants and restarted at once. Sometimes an end
restarts with another layout of the request; the other end gets this layout when it is killed next. Sometimes the region
of the requests is removed, or all regions if both ends are killed. The PLC is the generated Structured Text in the
tests' soft PLC, in a separate process. `--fault` plants a fault, which the run must detect: a block of
tests/support/plc_calls.py, or a check that Python's runtime leaves out.
"""

from __future__ import annotations

import argparse
import os
import random
import signal
import sys
import tempfile
import time
import uuid
from collections import Counter
from contextlib import suppress
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, NamedTuple

from shmgen import runtime
from shmgen.core.model import TypeName
from shmgen.runtime import calls as runtime_calls
from shmgen.runtime.reference import claim, reader
from tests.support import engines
from tests.support.build import forget, module
from tests.support.plc_calls import FAULTS, PACKAGE, open_or_make

from . import chaos_ends
from .chaos_ends import (
    ENTRY,
    Stage,
    Work,
    act,
    ask,
    is_later,
    plc_act,
    plc_ask,
    plc_send_goals,
    plc_serve,
    send_goals,
    serve,
)

UPDATES, REMOVALS = 0.15, 0.15
"""Probabilities that a killed end restarts with another layout, and that the requests' region is removed before."""


@dataclass
class Verdict:
    """Result of a run. `ends` counts how calls ended: reply, failed, timeout, no server, cancelled, region error."""

    ends: Counter[str] = field(default_factory=Counter)
    kills: Counter[str] = field(default_factory=Counter)
    updates: int = 0
    removals: int = 0
    errors: list[str] = field(default_factory=list)
    last_served: int = 0


class Scene(NamedTuple):
    """Two ends, choices of ends to kill, and the longest pause. A killed PLC takes a second to claim its topics."""

    works: tuple[Work, Work]
    hits: tuple[tuple[int, ...], ...]
    pause: float


def _take_any_reply() -> None:
    """Let a client in Python accept the reply to another call as its own."""

    def accept(client: Any, response: Any) -> Any:
        if response is not None:
            client.number = 0
        return response

    runtime_calls.CallClient._own = accept  # type: ignore[method-assign]


def _serve_old_calls() -> None:
    """Let a server in Python serve calls that are older than the server."""
    engines.become_python()
    reader.Reader.skip = lambda self: None  # type: ignore[method-assign]


def _begin_at_one() -> None:
    """Let a client in Python begin at 1 in each new region, and switch off the check of the numbers' order."""
    engines.become_python()
    claim._begin_numbers = lambda topic, region: None
    chaos_ends.is_later = lambda number, than: True


PYTHON_FAULTS = {
    "python_client": _take_any_reply,
    "python_server": _serve_old_calls,
    "python_numbers": _begin_at_one,
}
_EVEN, _SERVER, _CLIENT = ((0,), (1,), (0, 1)), ((0,), (0,), (0,), (0,), (1,), (0, 1)), ((0,), *[(1,)] * 4, (0, 1))
SCENES = {
    "python_alone": Scene((serve, ask), _EVEN, 0.1),
    "plc_serves": Scene((plc_serve, ask), _CLIENT, 0.5),
    "plc_asks": Scene((serve, plc_ask), _SERVER, 0.5),
    "plc_alone": Scene((plc_serve, plc_ask), _EVEN, 2.0),
    "python_goals": Scene((act, send_goals), _EVEN, 0.1),
    "plc_serves_goals": Scene((plc_act, send_goals), _CLIENT, 0.5),
    "plc_sends_goals": Scene((act, plc_send_goals), _SERVER, 0.5),
    "plc_goals": Scene((plc_act, plc_send_goals), _EVEN, 2.0),
}
"""Server and client; choices of the ends to kill; the longest pause between two kills in seconds."""


def run(folder: Path, scene: str, number: int, seed: int, fault: str = "", longest: float = 600.0) -> Verdict:
    """Run `number` calls, but stop after `longest` seconds or at the first error."""
    verdict, storm = Verdict(), Storm(folder, SCENES[scene], random.Random(seed), fault)
    end = time.monotonic() + longest
    try:
        while sum(verdict.ends.values()) < number and time.monotonic() < end and not verdict.errors:
            due = time.monotonic() + storm.pause()
            while time.monotonic() < due:
                time.sleep(0.005)
                storm.listen(verdict)
            storm.hit(verdict)
    finally:
        storm.end(verdict)
    return verdict


class Storm:
    """The two ends of a scene, which are killed, updated and restarted."""

    def __init__(self, folder: Path, scene: Scene, dice: random.Random, fault: str) -> None:
        self._scene, self._dice, self._fault = scene, dice, fault
        self._name = f"/shmgen_test/t{uuid.uuid4().hex}"
        self._reports, self._writer = os.pipe2(os.O_CLOEXEC)
        os.set_blocking(self._reports, False)
        self._stages = [self._create_stage(folder), self._create_stage(folder / "updated", "float64 more\n")]
        self._version, self._is_updated = 0, False
        self._children = [self._start_child(place) for place in (0, 1)]

    def pause(self) -> float:
        """Return the seconds until the next hit. After an update, a PLC needs one second more for its region."""
        extra = 1.5 if self._is_updated and self._scene.pause > 0.3 else 0.0
        self._is_updated = False
        return extra + self._dice.uniform(0.02, self._scene.pause)

    def hit(self, verdict: Verdict) -> None:
        """Stop one end or both with SIGKILL, sometimes update or remove regions, and restart the ends."""
        places = self._dice.choice(self._scene.hits)
        for place in places:
            _kill(self._children[place])
            verdict.kills[self._scene.works[place].__name__] += 1
        if self._dice.random() < UPDATES:
            self._version, self._is_updated = 1 - self._version, True
            verdict.updates += 1
        if len(places) == 2:
            self.listen(verdict)
            self._remove("")
            verdict.last_served = 0
        elif self._dice.random() < REMOVALS:
            self._remove("-request")
            self._remove("-goal")
            verdict.removals += 1
        for place in places:
            self._children[place] = self._start_child(place)

    def listen(self, verdict: Verdict) -> None:
        with suppress(BlockingIOError):
            while data := os.read(self._reports, 1000 * ENTRY.size):
                for kind, value in ENTRY.iter_unpack(data):
                    if kind == b"s":
                        if self._fault != "python_numbers" and not is_later(value, verdict.last_served):
                            verdict.errors.append(f"call {value} was served after call {verdict.last_served}")
                        verdict.last_served = value
                    elif kind == b"w":
                        verdict.errors.append(f"question {value:08X} got the answer to another")
                    elif kind == b"o":
                        verdict.errors.append(f"call {value} was there before the server that served it")
                    elif kind == b"l":
                        verdict.errors.append(f"a call lasted {value} ms too long")
                    else:
                        verdict.ends[kind.decode()] += 1

    def end(self, verdict: Verdict) -> None:
        for pid in self._children:
            _kill(pid)
        self.listen(verdict)
        os.close(self._reports)
        os.close(self._writer)
        self._remove("")

    def _create_stage(self, folder: Path, more: str = "") -> Stage:
        calls = open_or_make(folder, more)
        kinds = [module(folder, PACKAGE, TypeName("calls_msgs", kind, "")) for kind in ("srv", "action")]
        forget(PACKAGE)
        stage = Stage(calls, *kinds, self._name, self._writer)
        if self._fault in FAULTS and FAULTS[self._fault][0] == "FB_ShmClient":
            stage.client_fault = f"_{self._fault}"
        elif self._fault in FAULTS:
            stage.server_fault = f"_{self._fault}"
        return stage

    def _start_child(self, place: int) -> int:
        """Start an end of the present version, which reopens its regions when they were removed."""
        seed = self._dice.random()
        pid = os.fork()
        if pid:
            return pid
        try:
            if self._fault in PYTHON_FAULTS:
                PYTHON_FAULTS[self._fault]()
            dice = random.Random(seed)
            while True:
                with suppress(runtime.LayoutMismatch, runtime.RegionInUse, runtime.RegionUnusable):
                    self._scene.works[place](self._stages[self._version], dice)
                time.sleep(0.005)
        except BaseException as error:
            print(f"{self._scene.works[place].__name__}: {error!r}", file=sys.stderr)
        finally:
            os._exit(1)

    def _remove(self, half: str) -> None:
        for file in Path("/dev/shm").glob(f"*{self._name[1:].replace('/', '.')}{half}*"):
            file.unlink()


def _kill(pid: int) -> None:
    os.kill(pid, signal.SIGKILL)
    os.waitpid(pid, 0)


def main() -> None:
    """Exit with code 1 if a run found an error."""
    parser = argparse.ArgumentParser(description="Kills and updates a client and its server, in Python and in a PLC.")
    parser.add_argument("--calls", type=int, default=10_000)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--seconds", type=float, default=600.0)
    parser.add_argument("--scenes", nargs="*", choices=SCENES, default=list(SCENES))
    parser.add_argument("--fault", choices=("", *FAULTS, *PYTHON_FAULTS), default="")
    args = parser.parse_args()
    has_errors = False
    with tempfile.TemporaryDirectory(prefix="shmgen-chaos") as folder:
        for scene in args.scenes:
            started_at = time.monotonic()
            verdict = run(Path(folder), scene, args.calls, args.seed, args.fault, args.seconds)
            duration = f"{time.monotonic() - started_at:.0f} s"
            print(f"seed {args.seed}, {scene}: {verdict.ends.total()} calls {dict(verdict.ends)} in {duration}")
            print(f"  kills {dict(verdict.kills)}, {verdict.updates} updates, {verdict.removals} removals", flush=True)
            print(
                "\n".join(verdict.errors[:20]) or "  every call ended, none in the answer to another, none served twice"
            )
            has_errors |= bool(verdict.errors)
    sys.exit(has_errors)


if __name__ == "__main__":
    main()
