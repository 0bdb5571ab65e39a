"""The program of docs/safety.md stops the robot in time after each event that the page lists."""

from __future__ import annotations

import math
import re
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from shmgen import config
from shmgen.core.diagnostics import Report
from shmgen.core.model import TypeName
from shmgen.generator import pipeline

from ..conftest import REPOSITORY
from ..softplc import Plc, compile_st
from ..support.build import classes, put

PAGE = (REPOSITORY / "docs" / "safety.md").read_text()
CYCLE, SILENCE = 10, 100


@pytest.fixture(scope="module")
def generated(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, dict[str, str]]:
    folder = tmp_path_factory.mktemp("safety")
    (message,) = re.findall(r"# cell_msgs/msg/Command.msg\n(.*?)```", PAGE, re.DOTALL)
    toml = 'path = ["msgs"]\ntargets = ["python", "st"]\n[[topics]]\ntopic = "{}"\ntype = "cell_msgs/Command"\n'
    put({"msgs/cell_msgs/msg/Command.msg": message, "shmgen.toml": toml.format("/robot/command")}, folder)
    texts = pipeline.generate(config.load(folder / "shmgen.toml", "shmgen.toml", Report()), ())
    put({path: text for path, text in texts.items() if path.startswith("python/")}, folder)
    return folder, {path: text for path, text in texts.items() if path.endswith(".st")}


class Cell:
    """The PLC with the page's program, its clock, and a publisher of commands."""

    def __init__(self, plc: Plc, publisher: Any, command: Any) -> None:
        self.ros, self.guard = plc.block("PRG_Ros"), plc.block("PRG_Guard")
        self.plc, self.publisher, self.command = plc, publisher, command
        self.guard.xEmergencyStop = False

    def send(self, **values: object) -> None:
        self.command.alive += 1
        self.resend(**values)

    def resend(self, **values: object) -> None:
        for name, value in values.items():
            setattr(self.command, name, value)
        self.publisher.publish(self.command)

    def cycle(self) -> float:
        """Execute one cycle and return the speed."""
        self.plc.set_clock(self.plc.now + CYCLE)
        self.ros()
        self.guard()
        return float(self.guard.lrSpeed)

    def stops_after(self, each: Callable[[], object]) -> int:
        """Return the milliseconds from the last new `alive`, one cycle before, until the speed is 0."""
        for cycle in range(1, 50):
            each()
            if self.cycle() == 0.0:
                return cycle * CYCLE
        raise AssertionError("the robot never stopped")


@pytest.fixture
def cell(generated: tuple[Path, dict[str, str]], topic: str) -> Any:
    """A PLC whose robot moves at 0.2 m/s."""
    folder, st = generated
    (program,) = re.findall(r"```iecst\n(PROGRAM PRG_Guard.*?)```", PAGE, re.DOTALL)
    files = {path: text.replace("'/robot/command'", f"'{topic}'") for path, text in st.items()}
    plc = compile_st(files | {"guard.st": program})
    Command, CommandPublisher, _ = classes(folder, "shm_msgs", TypeName("cell_msgs", "msg", "Command"))
    plc.set_clock(10_000)
    with CommandPublisher(topic) as publisher:
        running = Cell(plc, publisher, Command(speed=0.2))
        for _ in range(100):
            running.send()
            assert running.cycle() == 0.0, "the robot moved without a reset"
        running.send(reset=1)
        assert running.cycle() == 0.2
        running.send(reset=0)
        assert running.cycle() == 0.2
        yield running


@pytest.mark.slow
@pytest.mark.parametrize(
    ("event", "after"),
    [
        (lambda cell: cell.send(stop=1), CYCLE),
        (lambda cell: cell.send(speed=math.nan), CYCLE),
        (lambda cell: cell.send(speed=0.26), CYCLE),
        (lambda cell: cell.send(speed=-0.1), CYCLE),
        (lambda cell: setattr(cell.guard, "xEmergencyStop", True), CYCLE),
        (lambda cell: None, SILENCE),
        (lambda cell: cell.publisher.heartbeat(), SILENCE),
        (lambda cell: cell.resend(), SILENCE),
    ],
    ids=["stop", "nan", "too fast", "backwards", "emergency stop", "killed", "hangs", "the same again"],
)
def test_robot_stops_in_time_and_waits_for_a_reset(cell: Cell, event: Callable[[Cell], object], after: int) -> None:
    assert cell.stops_after(lambda: event(cell)) == after
    cell.guard.xEmergencyStop = False
    was_invalid = not 0 <= cell.command.speed <= 0.25
    for _ in range(20):
        cell.send(stop=0, speed=0.2)
        assert cell.cycle() == (0.2 if was_invalid else 0.0)
    cell.send(reset=1)
    assert cell.cycle() == 0.2
    cell.send()  # a reset that stays TRUE is no rising edge
    cell.guard.xEmergencyStop = True
    assert cell.cycle() == 0.0
    cell.guard.xEmergencyStop = False
    cell.send()
    assert cell.cycle() == 0.0
