"""Judges what a PLC's runtime does with regions: the other side of PRG_ShmSelfTest, docs/verified.md.

Each check says what was measured beside what this project believes; none stops the others.
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
"""Commands of PRG_ShmSelfTest; 0 does nothing."""
_OPENED, _REFUSED = 2, 3
_RESULTS = {
    0: "OK", 1: "FAILED", 2: "PARAMETER", 5: "TIMEOUT", 15: "BUFFERSIZE", 16: "NO_OBJECT", 17: "NOMEMORY",
    18: "DUPLICATE", 25: "NO_ACCESS_RIGHTS",
}  # fmt: skip
_TIMEOUT_MS = 200
"""tTimeout of the topic whose publisher is killed."""
_CALLS_TIMED, _VALUES = 5000, 100
EXPECTED, DIFFERENT, NOTED, NOT_MEASURED = "as expected", "DIFFERENT", "noted", "not measured"


class Line(NamedTuple):
    """One of the report."""

    key: str
    verdict: str
    said: str

    def __str__(self) -> str:
        return f"{self.key:<14} {self.verdict:<12}  {self.said}"


class NotMeasured(Exception):
    """With the reason."""


class Partner:
    """Python's ends of the topics of the self-test. `tell` shows a request to the person at the IDE."""

    def __init__(self, session: Session, wait: float, tell: Callable[[str], object]) -> None:
        self.command, self.answer = (session.message(f"selftest_msgs/{name}") for name in ("Command", "Answer"))
        self.interval, self.patience, self.tell = session.config.task_interval, wait, tell
        self.publish = [sys.executable, "-m", "shmgen", "pub", f"{TOPIC}killed", "selftest_msgs/Command", "-r", "50"]
        self.publish += ["-c", str(session.config.root / "shmgen.toml")]
        self.said: Any = self.command(number=int(time.time()) % 2**31)
        self.is_first = not os.path.exists(region_file(f"{NAME}command"))
        self.commands = publisher(self.command, f"{TOPIC}command", 1)
        self.answers = subscriber(self.answer, f"{TOPIC}answer", 1)

    def close(self) -> None:
        """And takes away what the self-test made, but for what the PLC has open as long as it runs."""
        self.commands.close()
        self.answers.close()
        for name in (f"{NAME}{end}" for end in ("first", "pair", "made")):
            for file in (region_file(name), semaphore_file(name), semaphore_file(event_name(name))):
                with suppress(OSError):
                    os.unlink(file)

    def heard(self, wanted: Callable[[Any], bool], seconds: float) -> Any:
        """The first answer that is as wanted, or None."""
        until = time.monotonic() + seconds
        while time.monotonic() < until:
            answer = self.answers.wait(0.05)
            self.commands.heartbeat()
            if answer is not None and wanted(answer):
                return answer
        return None

    def ask(self, what: int = 0, count: int = 0, seconds: float = 5.0) -> Any:
        """What the PLC answers to a command. Raises TimeoutError."""
        self.said.number, self.said.what, self.said.count = self.said.number + 1, what, count
        self.commands.publish(self.said)
        answer = self.heard(lambda answer: bool(answer.number == self.said.number), seconds)
        if answer is None:
            raise TimeoutError
        return answer


def report(partner: Partner) -> Iterator[Line]:
    """One line after the other; without an answer to the first all others are not measured."""
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
    """What the report is of, as far as it can be seen from here."""
    machine = f"{platform.system()} {platform.release()} {platform.machine()}, {' '.join(platform.libc_ver())}"
    groups = " ".join(sorted(map(name_of_group, {os.getgid(), *os.getgroups()})))
    python = f"Python {platform.python_version()}, {struct.calcsize('P') * 8} bit"
    return f"{machine}; {python}; {name_of_user(os.getuid())} ({groups})"


Found = tuple[str, str]
"""Verdict and text of a check."""


def _task(partner: Partner) -> Line:
    begun = partner.heard(lambda answer: True, partner.patience)
    if begun is None:
        hint = "look at xError and eErrorID of GVL_Ros.shm_selftest_answer and shm_selftest_command"
        return Line("task", NOT_MEASURED, f"no answer within {partner.patience:g} s: {hint}")
    try:
        before, since = partner.ask(), time.monotonic()
        time.sleep(1.0)
        after = partner.heard(lambda answer: bool(answer.cycles > before.cycles), 2.0) or before
    except TimeoutError:
        return Line("task", NOT_MEASURED, "the PLC sends, and does not hear /shm_selftest/command")
    mean = 1000 * (time.monotonic() - since) / max(1, after.cycles - before.cycles)
    good = abs(mean - partner.interval) < 0.5 * partner.interval
    width = f", {after.shortest} to {after.longest} ms" if after.longest else ""
    said = f"PRG_ShmSelfTest is called each {mean:.1f} ms{width}; {partner.interval:g} were asked for"
    return Line("task", EXPECTED if good else DIFFERENT, said)


def _width(partner: Partner) -> Found:
    _asked(partner, 0)
    size, own = partner.ask().pointer_size, struct.calcsize("P")
    return EXPECTED if size == own else DIFFERENT, f"the runtime has {8 * size} bit, this Python {8 * own}"


def _python_first(partner: Partner) -> Found:
    if not partner.is_first:
        raise NotMeasured("its region was there: stop the PLC, `shmgen clean --all`, and start this first")
    return EXPECTED, f"the PLC opened what Python made: {_file(region_file(f'{NAME}command'))}"


def _open(partner: Partner) -> Found:
    missing, made, other = _asked(partner, _OPEN)[:3]
    said = f"Open of what is missing {_result(missing)}, of another size {_result(other)}, Create {_result(made)}"
    good = (missing, made, other) == (16, 0, 15)
    return EXPECTED if good else DIFFERENT, f"{said}: {_file(region_file(f'{NAME}made'))}"


def _semaphore(partner: Partner) -> Found:
    made, first, second, leave, again = _asked(partner, _SEMAPHORE)[:5]
    good = made == 0 and first in (0, 5) and (second, leave) == (5, 0) and again in (0, 18)
    begins = {0: "begins at 1", 5: "begins at 0"}.get(first, f"first Enter {_result(first)}")
    said = f"Create {_result(made)}, {begins}, then Enter {_result(second)}, Leave {_result(leave)}"
    path = semaphore_file(f"{NAME}made")
    return EXPECTED if good else DIFFERENT, f"{said}, Create again {_result(again)}; {_file(path)}"


def _delete(partner: Partner) -> Found:
    path = semaphore_file(f"{NAME}made")
    if not os.path.exists(path):
        raise NotMeasured("no semaphore was made")
    deleted, other = _asked(partner, _DELETE)[:2]
    stays = "the file stays" if os.path.exists(path) else "the file is gone"
    return NOTED, f"SysSemProcessDelete {_result(deleted)}: {stays}, Enter by another handle {_result(other)}"


def _plc_first(partner: Partner) -> Found:
    partner.ask(_FIRST, 1)
    answer = partner.heard(lambda answer: answer.first in (_OPENED, _REFUSED), 10.0)
    if answer is None or answer.first == _REFUSED:
        return DIFFERENT, "the PLC could not make a region: fbFirst.eErrorID in PRG_ShmSelfTest"
    made = f"{_file(region_file(f'{NAME}first'))}, semaphore {_file(semaphore_file(f'{NAME}first'))}"
    with subscriber(partner.command, f"{TOPIC}first", 1) as heard:
        sample = heard.wait(2.0)
    partner.ask(_FIRST, 0)
    return (EXPECTED if sample else DIFFERENT), f"{made}: {'Python reads it' if sample else 'no sample comes'}"


def _exchange(partner: Partner) -> Found:
    took, lost = [], 0
    for value in range(1, _VALUES + 1):
        partner.said.value, begun = value, time.monotonic()
        partner.commands.publish(partner.said)
        if partner.heard(lambda answer: bool(answer.value == partner.said.value), 1.0):
            took.append(1000 * (time.monotonic() - begun))
        elif (lost := lost + 1) > 3:
            break
    times = f"{statistics.median(took):.1f} ms there and back, at most {max(took):.1f}" if took else "none came back"
    return EXPECTED if not lost else DIFFERENT, f"{value} values, {lost} lost; {times}"


def _calls(partner: Partner) -> Found:
    until = time.monotonic() + 10.0
    while not _asked(partner, _CALLS)[2]:  # until both ends are open
        if time.monotonic() > until:
            return DIFFERENT, "the pair did not open"
    sent, read = (1000 * took / _CALLS_TIMED for took in partner.ask(_CALLS, _CALLS_TIMED, 30.0).results[:2])
    return NOTED, f"84 bytes: {sent:.1f} us to publish, {read:.1f} us to find nothing new"


def _killed(partner: Partner) -> Found:
    with subprocess.Popen(partner.publish, stdout=subprocess.DEVNULL) as one:
        heard = partner.heard(lambda answer: bool(answer.seen and not answer.stale), 10.0)
        one.kill()
    if not heard:
        return DIFFERENT, "the PLC never heard a publisher"
    gone = partner.heard(lambda answer: bool(answer.stale), 10.0)
    before, begun = gone.seen if gone else 0, time.monotonic()
    with subprocess.Popen(partner.publish, stdout=subprocess.DEVNULL) as one:
        again = partner.heard(lambda answer: bool(answer.seen > before and not answer.stale), 20.0)
        took = time.monotonic() - begun
        one.terminate()
    if not gone or not again:
        return DIFFERENT, f"xStale {'after' if gone else 'never'}, the next publisher {'was' if again else 'not'} heard"
    good = not gone.silent or _TIMEOUT_MS <= gone.silent <= _TIMEOUT_MS + 5 * partner.interval + 20
    stale = f"xStale {gone.silent} ms after the last sample, tTimeout {_TIMEOUT_MS} ms" if gone.silent else "xStale"
    return EXPECTED if good else DIFFERENT, f"{stale}; the next publisher was heard {took:.1f} s after its start"


def _restart(partner: Partner) -> Found:
    before = partner.ask().cycles
    partner.tell("Restart the PLC's runtime now, as `sudo systemctl restart codesyscontrol` does")
    since = time.monotonic()
    begun = partner.heard(lambda answer: bool(answer.cycles < before), partner.patience)
    if not begun:
        raise NotMeasured(f"no restart within {partner.patience:g} s")
    partner.ask(seconds=10.0)
    return EXPECTED, f"{time.monotonic() - since:.0f} s after the request the PLC answers again, both ways"


def _online_change(partner: Partner) -> Found:
    before = partner.ask()
    partner.tell("Set VERSION in PRG_ShmSelfTest to 2 and log in with online change")
    after = partner.heard(lambda answer: bool(answer.version != before.version), partner.patience)
    if not after:
        raise NotMeasured(f"no other VERSION within {partner.patience:g} s")
    partner.ask(seconds=10.0)
    if after.cycles < before.cycles:
        raise NotMeasured("that was a download: the program began anew")
    return EXPECTED, f"VERSION {after.version} from cycle {after.cycles} on, no end closed, both ways"


def _clock(partner: Partner) -> Found:
    partner.heard(lambda answer: True, 1.0)
    partner.answers.ready(1.0)
    stamps = [sample.stamp for sample in partner.answers.samples()]
    if not stamps or not stamps[-1]:
        raise NotMeasured("samples have no time: GVL_ShmClock.lwNow is 0")
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
"""What docs/evidence/codesys.md names; the last two want a person at the IDE."""


def _asked(partner: Partner, what: int) -> Any:
    """The results of a command that the program of OpenPLC does not know. Raises NotMeasured."""
    answer = partner.ask(what)
    if not answer.pointer_size:
        raise NotMeasured("the language has no Sys functions, pointers or clock")
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
