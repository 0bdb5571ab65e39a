"""docs/tutorial-plc.md to its end: its topics and its program in a PLC, and a robot that comes and goes."""

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


def test_the_program_of_the_tutorial(tmp_path: Path, topic: str) -> None:
    """Half of the robot's x; 0 before it has come, and after it has gone."""
    _, texts, st = project(tmp_path, topic)
    put(texts, tmp_path)
    plc = compile_st(st)
    programs = [plc.block(name) for name in ("PRG_Ros", "PRG_Conveyor")]

    def after(ms: int) -> float | None:
        """What the robot reads when the PLC has gone on for so long, called every 10 ms."""
        for _ in range(ms // 10):
            plc.set_clock(plc.now + 10)
            for called in programs:
                called()
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


@pytest.mark.parametrize(
    ("kind", "pages"), [("USINT", ["services.md", "codesys.md"]), ("BOOL", [])], ids=["USINT", "BOOL"]
)
def test_what_pages_write_into_a_bool_compiles(tmp_path: Path, kind: str, pages: list[str]) -> None:
    """Every line of theirs about /cell/start; and TRUE only where shmgen.toml asks for BOOL."""
    toml = '[[services]]\nservice = "/cell/start"\ntype = "cell_msgs/Start"\nserver = "plc"\n'
    put(
        {"msgs/cell_msgs/srv/Start.srv": "bool on\nuint16 program\n---\nbool success\nbool ok\nuint32 parts\n"},
        tmp_path,
    )
    put({"shmgen.toml": f'path = ["msgs"]\n[types]\nbool = "{kind}"\n{toml}'}, tmp_path)
    texts = pipeline.generate(config.load(tmp_path / "shmgen.toml", "shmgen.toml", Report()), ())
    st = {path: text for path, text in texts.items() if path.endswith(".st")} | {"machine.st": MACHINE}
    blocks = [
        block
        for page in pages
        for block in re.findall(r"```iecst\n(.*?)```", (REPOSITORY / "docs" / page).read_text(), re.DOTALL)
        if re.search(r"cell_start\.\w+\.(on_|ok|success)", block)
    ]
    assert len(blocks) == len(pages)
    variables = "VAR fbMachine : FB_Machine; xReady : BOOL; xOn : BOOL; END_VAR\n"
    programs = [("".join(blocks), True)] if blocks else []
    programs += [("GVL_Ros.cell_start.Response.ok := TRUE;\n", kind == "BOOL")]
    for body, fits in programs:
        whole = st | {"yours.st": f"PROGRAM PRG_Yours\n{variables}{body}END_PROGRAM\n"}
        if fits:
            compile_st(whole)
        else:
            with pytest.raises(CompileError):
                compile_st(whole)
