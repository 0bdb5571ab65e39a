"""Evaluates how a PLC's runtime handles regions, together with the PLC program PRG_ShmSelfTest (docs/guarantees.md).

Each check reports the measured behavior next to the expected behavior. A failed check does not stop the others.
"""

from __future__ import annotations

import os
import platform
import statistics
import struct
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from contextlib import suppress
from typing import Any, NamedTuple

from shmgen.live.classes import publisher, subscriber
from shmgen.live.session import Session
from shmgen.runtime import ShmError
from shmgen.runtime.region.access import name_of_group, name_of_user
from shmgen.runtime.region.names import event_name, region_file, semaphore_file
from shmgen.tools.doctor.problem import owner

TOPIC, NAME = "/shm_selftest/", "shm_selftest."
_OPEN, _SEMAPHORE, _DELETE, _FIRST, _CALLS = range(1, 6)
"""Commands of PRG_ShmSelfTest. Command 0 does nothing."""
_OPENED, _REFUSED = 2, 3
_RESULTS = {
    0: "OK", 1: "FAILED", 2: "PARAMETER", 5: "TIMEOUT", 15: "BUFFERSIZE", 16: "NO_OBJECT", 17: "NOMEMORY",
    18: "DUPLICATE", 25: "NO_ACCESS_RIGHTS",
}  # fmt: skip
_TIMEOUT_MS = 200
"""tTimeout in ms of the topic whose publisher is killed."""
_CALLS_TIMED, _VALUES = 5000, 100
EXPECTED, DIFFERENT, NOTED, NOT_MEASURED = "as expected", "DIFFERENT", "noted", "not measured"


class Line(NamedTuple):
    """One line of the report: the name of a check, its verdict, and the measured behavior."""

    key: str
    verdict: str
    behavior: str

    def __str__(self) -> str:
        return f"{self.key:<14} {self.verdict:<12}  {self.behavior}"


class NotMeasured(Exception):
    """A check could not run. The text is the reason."""


class Partner:
    """The Linux side of the self-test: sends commands to the PLC program and receives its answers.

    `tell` shows the user a step to do in the IDE, and `wait` is the time in seconds to wait for this step.
    """

    def __init__(self, session: Session, wait: float, tell: Callable[[str], object]) -> None:
        self.command, self.answer = (session.message(f"selftest_msgs/{name}") for name in ("Command", "Answer"))
        self.interval, self.patience, self.tell = session.config.task_interval, wait, tell
        self.publish = [sys.executable, "-m", "shmgen", "pub", f"{TOPIC}killed", "selftest_msgs/Command", "-r", "50"]
        self.publish += ["-c", str(session.config.root / "shmgen.toml")]
        self.request: Any = self.command(number=int(time.time()) % 2**31)
        self.is_first = not os.path.exists(region_file(f"{NAME}command"))
        self.commands = publisher(self.command, f"{TOPIC}command", 1)
        self.answers = subscriber(self.answer, f"{TOPIC}answer", 1)

    def close(self) -> None:
        """Close the topics. Remove the regions and semaphores of the self-test that the PLC does not keep open."""
        self.commands.close()
        self.answers.close()
        for name in (f"{NAME}{end}" for end in ("first", "pair", "made")):
            for file in (region_file(name), semaphore_file(name), semaphore_file(event_name(name))):
                with suppress(OSError):
                    os.unlink(file)

    def wait_for(self, is_expected: Callable[[Any], bool], seconds: float) -> Any:
        """Return the PLC's first answer for which `is_expected` returns True, or None after `seconds`."""
        until = time.monotonic() + seconds
        while time.monotonic() < until:
            answer = self.answers.wait(0.05)
            self.commands.heartbeat()
            if answer is not None and is_expected(answer):
                return answer
        return None

    def ask(self, what: int = 0, count: int = 0, seconds: float = 5.0) -> Any:
        """Send the command number `what` with the argument `count`, and return the PLC's answer.

        Raises TimeoutError if the PLC does not answer within `seconds`.
        """
        self.request.number, self.request.what, self.request.count = self.request.number + 1, what, count
        self.commands.publish(self.request)
        answer = self.wait_for(lambda answer: bool(answer.number == self.request.number), seconds)
        if answer is None:
            raise TimeoutError
        return answer


def report(partner: Partner) -> Iterator[Line]:
    """Run all checks and yield a line for each. If the first check gets no answer, skip the others."""
    first = _task(partner)
    yield first
    for key, check in CHECKS.items():
        if first.verdict == NOT_MEASURED:
            yield Line(key, NOT_MEASURED, "")
            continue
        try:
            yield Line(key, *check(partner))
        except NotMeasured as why:
            yield Line(key, NOT_MEASURED, str(why))
        except TimeoutError:
            yield Line(key, DIFFERENT, "the PLC stopped answering")
        except ShmError as error:
            yield Line(key, DIFFERENT, str(error).partition("\n")[0])


def head() -> str:
    """Return the first line of the report: the machine, the Python version, and the user with his groups."""
    machine = f"{platform.system()} {platform.release()} {platform.machine()}, {' '.join(platform.libc_ver())}"
    groups = " ".join(sorted(map(name_of_group, {os.getgid(), *os.getgroups()})))
    python = f"Python {platform.python_version()}, {struct.calcsize('P') * 8} bit"
    return f"{machine}; {python}; {name_of_user(os.getuid())} ({groups})"


Found = tuple[str, str]
"""The result of a check: its verdict, and the measured behavior as text."""


def _task(partner: Partner) -> Line:
    begun = partner.wait_for(lambda answer: True, partner.patience)
    if begun is None:
        hint = "see xError and eErrorID of GVL_Ros.shm_selftest_answer and shm_selftest_command"
        return Line("task", NOT_MEASURED, f"no answer within {partner.patience:g} s: {hint}")
    try:
        before, since = partner.ask(), time.monotonic()
        time.sleep(1.0)
        after = partner.wait_for(lambda answer: bool(answer.cycles > before.cycles), 2.0) or before
    except TimeoutError:
        return Line("task", NOT_MEASURED, "the PLC publishes, but does not receive /shm_selftest/command")
    mean = 1000 * (time.monotonic() - since) / max(1, after.cycles - before.cycles)
    good = abs(mean - partner.interval) < 0.5 * partner.interval
    width = f", {after.shortest} to {after.longest} ms" if after.longest else ""
    summary = f"PRG_ShmSelfTest is called each {mean:.1f} ms{width}; {partner.interval:g} ms is configured"
    return Line("task", EXPECTED if good else DIFFERENT, summary)


def _width(partner: Partner) -> Found:
    _results_of(partner, 0)
    size, own = partner.ask().pointer_size, struct.calcsize("P")
    return EXPECTED if size == own else DIFFERENT, f"the runtime has {8 * size} bits, this Python has {8 * own}"


def _python_first(partner: Partner) -> Found:
    if not partner.is_first:
        raise NotMeasured("the region existed already: stop the PLC, run `shmgen clean --all`, and start shmgen first")
    return EXPECTED, f"the PLC opened the region that Python created: {_file(region_file(f'{NAME}command'))}"


def _open(partner: Partner) -> Found:
    missing, created, other = _results_of(partner, _OPEN)[:3]
    summary = (
        f"Open of a missing region {_result(missing)}, of another size {_result(other)}, Create {_result(created)}"
    )
    good = (missing, created, other) == (16, 0, 15)
    return EXPECTED if good else DIFFERENT, f"{summary}: {_file(region_file(f'{NAME}made'))}"


def _semaphore(partner: Partner) -> Found:
    created, first, second, leave, again = _results_of(partner, _SEMAPHORE)[:5]
    good = created == 0 and first in (0, 5) and (second, leave) == (5, 0) and again in (0, 18)
    begins = {0: "begins at 1", 5: "begins at 0"}.get(first, f"first Enter {_result(first)}")
    summary = f"Create {_result(created)}, {begins}, then Enter {_result(second)}, Leave {_result(leave)}"
    path = semaphore_file(f"{NAME}made")
    return EXPECTED if good else DIFFERENT, f"{summary}, Create again {_result(again)}; {_file(path)}"


def _delete(partner: Partner) -> Found:
    path = semaphore_file(f"{NAME}made")
    if not os.path.exists(path):
        raise NotMeasured("no semaphore was created")
    deleted, other = _results_of(partner, _DELETE)[:2]
    stays = "the file stays" if os.path.exists(path) else "the file was removed"
    return NOTED, f"SysSemProcessDelete {_result(deleted)}: {stays}, Enter by another handle {_result(other)}"


def _plc_first(partner: Partner) -> Found:
    partner.ask(_FIRST, 1)
    answer = partner.wait_for(lambda answer: answer.first in (_OPENED, _REFUSED), 10.0)
    if answer is None or answer.first == _REFUSED:
        return DIFFERENT, "the PLC could not create a region: see fbFirst.eErrorID in PRG_ShmSelfTest"
    region_text = f"{_file(region_file(f'{NAME}first'))}, semaphore {_file(semaphore_file(f'{NAME}first'))}"
    with subscriber(partner.command, f"{TOPIC}first", 1) as first_subscriber:
        sample = first_subscriber.wait(2.0)
    partner.ask(_FIRST, 0)
    return (EXPECTED if sample else DIFFERENT), f"{region_text}: {'Python reads it' if sample else 'no sample arrives'}"


def _exchange(partner: Partner) -> Found:
    took, lost = [], 0
    for value in range(1, _VALUES + 1):
        partner.request.value, begun = value, time.monotonic()
        partner.commands.publish(partner.request)
        if partner.wait_for(lambda answer: bool(answer.value == partner.request.value), 1.0):
            took.append(1000 * (time.monotonic() - begun))
        elif (lost := lost + 1) > 3:
            break
    times = f"{statistics.median(took):.1f} ms for a round trip, at most {max(took):.1f}" if took else "none returned"
    return EXPECTED if not lost else DIFFERENT, f"{value} values, {lost} lost; {times}"


def _calls(partner: Partner) -> Found:
    until = time.monotonic() + 10.0
    while not _results_of(partner, _CALLS)[2]:  # wait until both ends are open
        if time.monotonic() > until:
            return DIFFERENT, "the pair did not open"
    sent, read = (1000 * took / _CALLS_TIMED for took in partner.ask(_CALLS, _CALLS_TIMED, 30.0).results[:2])
    return NOTED, f"84 bytes: {sent:.1f} us to publish, {read:.1f} us to look for a new sample"


def _killed(partner: Partner) -> Found:
    with subprocess.Popen(partner.publish, stdout=subprocess.DEVNULL) as one:
        live = partner.wait_for(lambda answer: bool(answer.seen and not answer.stale), 10.0)
        one.kill()
    if not live:
        return DIFFERENT, "the PLC never received a sample"
    last = partner.wait_for(lambda answer: bool(answer.stale), 10.0)
    before, begun = last.seen if last else 0, time.monotonic()
    with subprocess.Popen(partner.publish, stdout=subprocess.DEVNULL) as one:
        again = partner.wait_for(lambda answer: bool(answer.seen > before and not answer.stale), 20.0)
        took = time.monotonic() - begun
        one.terminate()
    if not last or not again:
        arrived = "arrived" if again else "did not arrive"
        return DIFFERENT, f"xStale {'after' if last else 'never'}, samples of the next publisher {arrived}"
    good = not last.silent or _TIMEOUT_MS <= last.silent <= _TIMEOUT_MS + 5 * partner.interval + 20
    stale = f"xStale {last.silent} ms after the last sample, tTimeout {_TIMEOUT_MS} ms" if last.silent else "xStale"
    return (
        EXPECTED if good else DIFFERENT,
        f"{stale}; samples of the next publisher arrived {took:.1f} s after its start",
    )


def _restart(partner: Partner) -> Found:
    before = partner.ask().cycles
    partner.tell("Restart the PLC's runtime now, for example with `sudo systemctl restart codesyscontrol`")
    since = time.monotonic()
    begun = partner.wait_for(lambda answer: bool(answer.cycles < before), partner.patience)
    if not begun:
        raise NotMeasured(f"no restart within {partner.patience:g} s")
    partner.ask(seconds=10.0)
    return EXPECTED, f"the PLC answers again {time.monotonic() - since:.0f} s after the request; samples pass both ways"


def _online_change(partner: Partner) -> Found:
    before = partner.ask()
    partner.tell("Set VERSION in PRG_ShmSelfTest to 2 and log in with online change")
    after = partner.wait_for(lambda answer: bool(answer.version != before.version), partner.patience)
    if not after:
        raise NotMeasured(f"VERSION did not change within {partner.patience:g} s")
    partner.ask(seconds=10.0)
    if after.cycles < before.cycles:
        raise NotMeasured("this was a download: the program started again")
    return EXPECTED, f"VERSION {after.version} since cycle {after.cycles}; samples pass both ways without a reopening"


def _clock(partner: Partner) -> Found:
    partner.wait_for(lambda answer: True, 1.0)
    partner.answers.ready(1.0)
    stamps = [sample.stamp for sample in partner.answers.samples()]
    if not stamps or not stamps[-1]:
        raise NotMeasured("samples have no stamp: GVL_ShmClock.lwNow is 0")
    return NOTED, f"samples are {1e-6 * (time.time_ns() - stamps[-1]):.1f} ms old by this machine's clock"


CHECKS: dict[str, Callable[[Partner], Found]] = {
    "width": _width,
    "python-first": _python_first,
    "open": _open,
    "semaphore": _semaphore,
    "delete": _delete,
    "plc-first": _plc_first,
    "exchange": _exchange,
    "call-time": _calls,
    "killed": _killed,
    "clock": _clock,
    "restart": _restart,
    "online-change": _online_change,
}
"""The checks, with their names in docs/evidence/codesys.md. The last two require actions of the user at the IDE."""


def _results_of(partner: Partner, what: int) -> Any:
    """Send the command number `what` to the PLC program, and return the results of the command.

    The commands call the Sys functions of CODESYS. Raises NotMeasured if the PLC lacks these functions, like OpenPLC.
    """
    answer = partner.ask(what)
    if not answer.pointer_size:
        raise NotMeasured("this PLC language has no Sys functions, pointers or clock")
    return answer.results


def _result(number: int) -> str:
    return f"{number} {_RESULTS.get(number, '')}".rstrip()


def _file(path: str) -> str:
    try:
        status = os.stat(path)
    except OSError as error:
        return f"{path}: {error.strerror}"
    mine = "" if os.access(path, os.R_OK | os.W_OK) else ", which this user may not write"
    return f"{owner(status)}, {status.st_size} bytes{mine}"
