"""The program of docs/tutorial-plc.md works in a PLC while a robot starts and stops."""

from __future__ import annotations

import re
from pathlib import Path

import pytest

from shmgen import config
from shmgen.core.diagnostics import Report
from shmgen.core.model import TypeName
from shmgen.generator import pipeline

from ..conftest import REPOSITORY
from ..softplc import CompileError, compile_st
from ..support.build import classes, put
from ..support.tutorial import project


def test_tutorial_program_publishes_half_of_x(tmp_path: Path, topic: str) -> None:
    """Publish half of the robot's x, and 0 before the robot starts and after it stops."""
    _, texts, st = project("tutorial-plc.md", tmp_path, topic)
    put(texts, tmp_path)
    plc = compile_st(st)
    programs = [plc.block(name) for name in ("PRG_Ros", "PRG_Conveyor")]

    def after(ms: int) -> float | None:
        """Run the PLC for this time with a cycle of 10 ms. Return the speed that the robot reads."""
        for _ in range(ms // 10):
            plc.set_clock(plc.now + 10)
            for program in programs:
                program()
        newest = speed.read()
        return None if newest is None else newest.data

    Pose, PosePublisher, _ = classes(tmp_path, "shm_msgs", TypeName("geometry_msgs", "msg", "Pose"))
    _, _, Float64Subscriber = classes(tmp_path, "shm_msgs", TypeName("std_msgs", "msg", "Float64"))
    plc.set_clock(0)
    with Float64Subscriber(f"{topic}/conveyor/speed") as speed:
        assert after(500) == 0.0
        with PosePublisher(f"{topic}/robot/target") as target:
            message = Pose()
            message.position.x = 1.5
            target.publish(message)
            assert after(500) == 0.75
        assert after(10_000) == 0.0


MACHINE = """FUNCTION_BLOCK FB_Machine
VAR_INPUT xExecute : BOOL; xOn : BOOL; END_VAR
VAR_OUTPUT xDone : BOOL; xError : BOOL; END_VAR
xDone := xExecute AND xOn;
END_FUNCTION_BLOCK
"""


@pytest.mark.slow
@pytest.mark.parametrize("kind", ["USINT", "BOOL"])
def test_services_of_the_codesys_page_compile(tmp_path: Path, kind: str) -> None:
    """Compile the calls of the page. TRUE fits only a BOOL, and BOOL_TO_USINT only a USINT."""
    page = (REPOSITORY / "docs" / "codesys.md").read_text()
    (toml,) = [block for block in re.findall(r"```toml\n(.*?)```", page, re.DOTALL) if "[[services]]" in block]
    put({"shmgen.toml": f'[types]\nbool = "{kind}"\n{toml}'}, tmp_path)
    texts = pipeline.generate(config.load(tmp_path / "shmgen.toml", "shmgen.toml", Report()), ())
    st = {path: text for path, text in texts.items() if path.endswith(".st")} | {"machine.st": MACHINE}
    blocks = [
        block
        for block in re.findall(r"```iecst\n(.*?)```", page, re.DOTALL)
        if re.search(r"cell_start\.\w+\.|robot_home\.", block)
    ]
    assert len(blocks) == 2
    variables = "VAR fbMachine : FB_Machine; xGoHome, xAlarm : BOOL; END_VAR\n"
    programs = [("".join(blocks), kind == "USINT"), ("GVL_Ros.cell_start.Response.success := TRUE;\n", kind == "BOOL")]
    for body, fits in programs:
        whole = st | {"yours.st": f"PROGRAM PRG_Yours\n{variables}{body}END_PROGRAM\n"}
        if fits:
            compile_st(whole)
        else:
            with pytest.raises(CompileError):
                compile_st(whole)
