"""`shmgen bridge` with DDS: a peer that is not ours, a PLC's program, and back; each of the three dies and returns."""

from __future__ import annotations

import os
import re
import signal
import subprocess
import sys
import time
from collections.abc import Iterator
from pathlib import Path

import pytest

from shmgen import pipeline
from shmgen.bridge.dds_types import topic_name
from shmgen.config import load
from shmgen.diagnostics import Report
from tests.softplc import compile_st

from ..conftest import REPOSITORY
from ..support.ros1 import Bridge
from .peers import running

CONFIG = """
task_interval = 1
[types]
time = "LTIME"
[bounds]
sensor_msgs = 4
[[topics]]
topic = "{topic}/joints"
type = "sensor_msgs/JointState"
depth = 8
qos = "{qos}"
[[topics]]
topic = "{topic}/joints_back"
type = "sensor_msgs/JointState"
direction = "from_plc"
depth = 8
qos = "{qos}"
"""
PROGRAM = """
PROGRAM PRG_Echo
GVL_Ros.{name}_joints.xNewest := FALSE;
GVL_Ros.{name}_joints_back.xSend := GVL_Ros.{name}_joints.xNewData;
GVL_Ros.{name}_joints_back.Msg := GVL_Ros.{name}_joints.Msg;
GVL_Ros.{name}_joints_back.Msg.position[0] := GVL_Ros.{name}_joints.Msg.position[0] + 1.0;
END_PROGRAM
"""
ANSWER = f"^took {re.escape('12.345678901 base shoulder elbow 1.5 -1.25 | 0 1')}$"
"""What the peer said, by way of the program."""
TYPE = "sensor_msgs::msg::dds_::JointState_"


@pytest.fixture
def library(tmp_path: Path, topic: str) -> Path:
    """The program over the topics of CONFIG, compiled."""
    (tmp_path / "shmgen.toml").write_text(CONFIG.format(topic=topic, qos="reliable"))
    config = load(tmp_path / "shmgen.toml", "shmgen.toml", Report())
    texts = {path: text for path, text in pipeline.generate(config, []).items() if path.endswith(".st")}
    name = topic.strip("/").replace("/", "_")
    compile_st({**texts, "PRG_Echo.st": PROGRAM.format(name=name)}, tmp_path / "plc")
    return tmp_path / "plc" / "plc.so"


@pytest.fixture
def processes() -> Iterator[list[subprocess.Popen[str]]]:
    started: list[subprocess.Popen[str]] = []
    yield started
    for process in started:
        process.kill()
        process.communicate()


def test_through_a_plc_and_back(
    peer: Path, library: Path, domain: int, topic: str, processes: list[subprocess.Popen[str]]
) -> None:
    def start(*words: object, ready: str) -> Bridge:
        environment = {**os.environ, "PYTHONPATH": f"{REPOSITORY / 'src'}:{REPOSITORY}", "PYTHONUNBUFFERED": "1"}
        command = [sys.executable, "-m", *map(str, words)]
        process = subprocess.Popen(
            command, cwd=library.parents[1], env=environment, stdout=-1, stderr=subprocess.STDOUT, text=True
        )
        processes.append(process)
        started = Bridge(process)
        started.said(ready)
        return started

    def bridge() -> Bridge:
        return start("shmgen", "bridge", "--backend", "dds", ready="^running")

    def plc() -> Bridge:
        return start("tests.softplc.task", library, "PRG_Ros", "PRG_Echo", ready="^running")

    tasks = [TYPE, "-", topic_name(f"{topic}/joints")]
    tasks += [TYPE, topic_name(f"{topic}/joints_back"), topic_name(f"{topic}/again")]
    ours, program = bridge(), plc()
    with running(peer, domain, "reliable", "volatile", *tasks) as theirs:
        theirs.said(ANSWER, 3)

        ours.kill()
        theirs.lines.clear()
        ours = bridge()
        theirs.said(ANSWER, 3)

        program.kill()
        theirs.lines.clear()
        plc()
        theirs.said(ANSWER, 3)
    time.sleep(0.5)
    with running(peer, domain, "reliable", "volatile", *tasks) as theirs:
        theirs.said(ANSWER, 3)
        assert not [line for line in theirs.lines if line.startswith("took") and not re.match(ANSWER, line)]
    assert ours.stop(signal.SIGTERM) < 3
    ours.said("/joints_back +[0-9]+ passed")
