"""`shmgen selftest` passes on the soft PLC and on blocks of OpenPLC and matiec, and reports planted faults."""

from __future__ import annotations

import re
import subprocess
import sys
import tempfile
import threading
import time
from collections.abc import Callable, Iterator
from functools import partial
from pathlib import Path
from typing import Any

import pytest

from shmgen import config
from shmgen.core.diagnostics import Report
from shmgen.generator.render import template_folder
from shmgen.generator.selftest import texts
from shmgen.live.session import Session
from shmgen.tools import selftest
from tests.softplc import Plc, compile_st, online_change
from tests.softplc.online_change import change_globals

from ..conftest import REPOSITORY
from ..support import kept, open_plc

PROGRAMS = ("PRG_Ros", "PRG_ShmSelfTest")
OTHER = {"VERSION   : UDINT := 1": "VERSION   : UDINT := 2"}
WRONG = {
    "pointer_size := SIZEOF(pNothing)": "pointer_size := 4",
    "stAnswer.value := GVL_Ros.shm_selftest_command.Msg.value": "stAnswer.value := 0",
    "tTimeout := T#200ms": "tTimeout := T#900ms",
}


class Running(threading.Thread):
    """The task of a PLC. It calls the functions in `next` between two cycles."""

    def __init__(self, cycle: Callable[[], object]) -> None:
        super().__init__(daemon=True)
        self.cycle = cycle
        self.next: list[Callable[[], object]] = []
        self.ended = threading.Event()

    def run(self) -> None:
        while not self.ended.is_set():
            while self.next:
                self.next.pop()()
            self.cycle()

    def start_soft(self, plc: Plc, period: float) -> None:
        """Start both programs with initial values, as a restart of the PLC does. A restart closes nothing."""
        blocks = [plc.block(name) for name in PROGRAMS]
        self.cycle = lambda: plc.run(blocks, period, 5)
        self.change = partial(self._change, plc, blocks, period)

    def _change(self, plc: Plc, blocks: list[Any], period: float, to: Plc) -> None:
        change_globals(plc.globals("GVL_Ros"), to.globals("GVL_Ros"))
        new = [online_change(block, to) for block in blocks]
        self.cycle = lambda: to.run(new, period, 5)


@pytest.fixture(scope="module")
def settings() -> config.Config:
    return config.load(template_folder() / "selftest" / "shmgen.toml", "shmgen.toml", Report())


def compile_selftest(settings: config.Config, changes: dict[str, str]) -> Plc:
    """Compile both programs side by side, because programs of the stand-in cannot call each other."""
    files = {path: text for path, text in texts(settings, False).items() if path.endswith(".st")}
    assert files["st/PRG_Ros.st"].count("\nPRG_ShmSelfTest();\n") == 1
    files["st/PRG_Ros.st"] = files["st/PRG_Ros.st"].replace("\nPRG_ShmSelfTest();\n", "\n")
    for old, new in changes.items():
        assert old in files["st/PRG_ShmSelfTest.st"]
        files["st/PRG_ShmSelfTest.st"] = files["st/PRG_ShmSelfTest.st"].replace(old, new)
    return compile_st(files)


@pytest.fixture
def plc(settings: config.Config) -> Plc:
    return compile_selftest(settings, {})


@pytest.fixture
def task() -> Iterator[Running]:
    """A PLC task. Only one exists on the machine at a time, because its topics have fixed names."""
    with kept.locked(Path(tempfile.gettempdir()) / "shmgen-selftest.lock"):
        remove_regions()  # a killed run may have left regions
        running = Running(lambda: None)
        yield running
        running.ended.set()
        if running.is_alive():
            running.join(5)
        remove_regions()


def remove_regions() -> None:
    for file in Path("/dev/shm").glob("*shm_selftest.*"):
        file.unlink()


def run(
    settings: config.Config, task: Running, by_hand: Callable[[str], object] = lambda request: None, wait: float = 2.0
) -> dict[str, selftest.Line]:
    partner = selftest.Partner(Session(settings), wait, by_hand)
    task.start()
    try:
        return {line.key: line for line in selftest.report(partner)}
    finally:
        partner.close()


@pytest.mark.slow
def test_selftest_passes_on_the_soft_plc(settings: config.Config, plc: Plc, task: Running) -> None:
    """Restart the PLC and change it online when the selftest requests both from a person."""
    again, other = compile_selftest(settings, {}), compile_selftest(settings, OTHER)
    requests = []

    def by_hand(request: str) -> None:
        requests.append(request)
        task.next.append(partial(task.start_soft, again, 0.01) if "estart" in request else partial(task.change, other))

    task.start_soft(plc, 0.01)
    lines = run(settings, task, by_hand, wait=10.0)
    assert len(requests) == 2
    verdicts = {key: line.verdict for key, line in lines.items()}
    noted = dict.fromkeys(("delete", "call-time"), selftest.NOTED) | {"clock": selftest.NOT_MEASURED}
    assert verdicts == dict.fromkeys(("task", *selftest.CHECKS), selftest.EXPECTED) | noted, lines
    assert "Create 0 OK, begins at 1" in lines["semaphore"].behavior
    assert re.search(r"84 bytes: [\d.]+ us to publish, [\d.]+ us", lines["call-time"].behavior)
    assert all(str(line).isprintable() for line in lines.values())


PLANTED: dict[str, tuple[Callable[[Plc], object], str]] = {
    "open": (lambda plc: plc.fail("SysSharedMemoryOpen2", 1), "Open of a missing region 1 FAILED"),
    "plc-first": (lambda plc: plc.fail("SysSharedMemoryCreate", 25), "the PLC could not create a region"),
    "semaphore": (lambda plc: plc.born(2), "begins at 1, then Enter 0 OK"),
    "delete": (lambda plc: plc.fail("SysSemProcessDelete", 2), "SysSemProcessDelete 2 PARAMETER: the file stays"),
}


@pytest.mark.parametrize("key", PLANTED)
def test_runtime_fault_is_reported(
    key: str, settings: config.Config, plc: Plc, task: Running, monkeypatch: pytest.MonkeyPatch
) -> None:
    plant, behavior = PLANTED[key]

    def plant_and_check(partner: selftest.Partner) -> tuple[str, str]:
        plant(plc)
        return check(partner)

    check = selftest.CHECKS[key]
    monkeypatch.setattr(selftest, "CHECKS", {"semaphore": selftest.CHECKS["semaphore"]} | {key: plant_and_check})
    task.start_soft(plc, 0.01)
    line = run(settings, task)[key]
    assert behavior in line.behavior
    assert line.verdict == (selftest.NOTED if key == "delete" else selftest.DIFFERENT)


@pytest.mark.slow
def test_program_fault_is_reported(settings: config.Config, task: Running, monkeypatch: pytest.MonkeyPatch) -> None:
    """Report a wrong pointer size, values that do not return, a late timeout and a slow task."""
    checks = {key: selftest.CHECKS[key] for key in ("width", "exchange", "killed")}
    monkeypatch.setattr(selftest, "CHECKS", checks)
    task.start_soft(compile_selftest(settings, WRONG), 0.03)
    lines = run(settings, task)
    assert {line.verdict for line in lines.values()} == {selftest.DIFFERENT}, lines
    assert re.search(r"called each [3-9]\d", lines["task"].behavior)  # 30 ms plus delays of the machine
    assert "32 bit" in lines["width"].behavior
    assert "4 lost; none returned" in lines["exchange"].behavior
    assert re.match(r"xStale (9|1\d)\d\d ms after the last sample", lines["killed"].behavior)


def test_missing_answer_of_the_plc_is_reported(settings: config.Config, task: Running) -> None:
    lines = run(settings, task, wait=0.2)
    assert "eErrorID of GVL_Ros.shm_selftest_answer" in lines["task"].behavior
    assert {line.verdict for line in lines.values()} == {selftest.NOT_MEASURED}


@pytest.mark.parametrize("compiler", open_plc.COMPILERS)
@pytest.mark.sample("[openplc-v4]")
def test_selftest_passes_on_open_plcs(compiler: str, settings: config.Config, task: Running, tmp_path: Path) -> None:
    """Execute the program of templates/selftest/open line by line in Python. iec2c is tested by hand."""
    program = open_plc.Program(open_plc.compiled(texts(settings, True), compiler, tmp_path))
    stem = "FB_selftest_msgs"
    command, killed = (
        program.block(f"{stem}_Command_Subscriber", sTopic=f"/shm_selftest/{name}", xEnable=True, udiDepth=1)
        for name in ("command", "killed")
    )
    first = program.block(f"{stem}_Command_Publisher", sTopic="/shm_selftest/first", udiDepth=1)
    answer = program.block(f"{stem}_Answer_Publisher", sTopic="/shm_selftest/answer", xEnable=True, udiDepth=1)

    def cycle() -> None:
        command()
        killed()
        answer()
        answer.Msg_cycles, answer.Msg_version, answer.Msg_value = answer.Msg_cycles + 1, 1, command.Msg_value
        answer.Msg_seen, answer.Msg_stale = killed.udiSequence, killed.xStale
        if command.xNewData:
            answer.Msg_number = command.Msg_number
            first.xEnable = command.Msg_count > 0 if command.Msg_what == 4 else first.xEnable
        first()
        answer.Msg_first = 3 if first.xError else 2 if first.xSent else first.xBusy
        task.ended.wait(0.01 - time.monotonic() % 0.01)

    task.cycle = cycle
    lines = run(settings, task, wait=0.5)
    measured = {key: line.verdict for key, line in lines.items() if line.verdict != selftest.NOT_MEASURED}
    expected = dict.fromkeys(("task", "python-first", "plc-first", "exchange", "killed"), selftest.EXPECTED)
    assert measured == expected | {"clock": selftest.NOTED}, lines


def test_selftest_command_writes_files_for_an_ide(tmp_path: Path, task: Running) -> None:
    """Print the files to import, and report all checks as not measured if there is no PLC."""
    command = [sys.executable, "-m", "shmgen", "selftest", "--wait", "0.2"]
    done = subprocess.run(command, cwd=tmp_path, capture_output=True, text=True, check=False, timeout=60)
    assert done.returncode == 0, done.stderr
    assert done.stdout.startswith("PLC: load selftest/plcopen/import_shmgen.py")
    keys = [line.split()[0] for line in done.stdout.splitlines() if " not measured" in line]
    assert keys == ["task", *selftest.CHECKS]
    project = (tmp_path / "selftest/plcopen/shmgen.xml").read_text()
    assert '<pou name="PRG_ShmSelfTest" pouType="program">' in project
    assert "\nPRG_ShmSelfTest();</xhtml>" in project
    done = subprocess.run([*command, "--openplc", "--write", "open"], cwd=tmp_path, capture_output=True, text=True)
    assert "PROGRAM Run_PRG_ShmSelfTest WITH RosTask" in (tmp_path / "open/matiec/upload.st").read_text()


def test_docs_contain_the_keys_of_the_report() -> None:
    """Require a key for each point of docs/evidence/codesys.md, and a row of the table for each key."""
    keys = ["task", *selftest.CHECKS]
    unsure = (REPOSITORY / "docs/evidence/codesys.md").read_text()
    for point in re.split(r"^\* ", unsure, flags=re.MULTILINE)[1:]:
        named = re.findall(r"\[`([\w-]+)`\]\(\.\./guarantees\.md", point)
        assert named or "By hand:" in point, point
        assert set(named) <= set(keys), point
    page = (REPOSITORY / "docs/guarantees.md").read_text()
    assert re.findall(r"^\| `([\w-]+)` \|", page, re.MULTILINE) == keys
    assert page.count("No user has sent a report yet.") == 1
