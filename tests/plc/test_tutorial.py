"""docs/tutorial-plc.md to its end: its topics and its program in a PLC, and a robot that comes and goes."""

from __future__ import annotations

from pathlib import Path

from shmgen.core.model import TypeName

from ..softplc import compile_st
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
