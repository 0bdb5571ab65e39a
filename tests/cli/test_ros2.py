"""Test `ros2 shm`: the ros2 command line finds its entry point, and forwards all words to shmgen."""

from __future__ import annotations

import argparse
import os
import re
import subprocess
from collections.abc import Sequence
from importlib.metadata import entry_points
from pathlib import Path

import pytest

from ..support import ros2
from ..support.command import run


def forwarded_words(words: Sequence[str]) -> list[str]:
    """Return the words that shmgen receives from `ros2 shm words…`. Like ros2cli, use a parser inside a parser."""
    (entry,) = entry_points(group="ros2cli.command", name="shm")
    extension = entry.load()()
    parser = argparse.ArgumentParser(prog="ros2")
    parser.add_argument("--use-python-default-buffering", action="store_true")
    inner = parser.add_subparsers(dest=" _command").add_parser(extension.NAME)
    extension.add_arguments(inner, "ros2 shm")
    return list(parser.parse_args(["shm", *words]).words)


@pytest.mark.parametrize(
    "words",
    ["", "topics", "topics --json", "-h", "--version", "echo -h", "echo /a -n 3 --field -- x", "pub /a b/C 'x: -1'"],
)
def test_all_words_are_forwarded_to_shmgen(words: str) -> None:
    assert forwarded_words(words.split()) == words.split()


def test_ros2_command_line_runs_shmgen(tmp_path: Path, topic: str) -> None:
    """Use the ros2cli of a sourced ROS or of SHMGEN_ROS2CLI, because no package index contains ros2cli."""
    python = ros2.prefix("jazzy") / "bin" / "python"
    folders = [os.environ.get("SHMGEN_ROS2CLI", ""), os.environ.get("PYTHONPATH", "")]
    environment = {**os.environ, "PYTHONPATH": ":".join(filter(None, folders))}

    def run_ros2(*words: str) -> tuple[int, str]:
        code = "import sys; from ros2cli.cli import main; sys.argv[0] = 'ros2'; sys.exit(main())"
        command = [python, "-c", code, *words]
        result = subprocess.run(command, env=environment, cwd=tmp_path, capture_output=True, text=True, check=False)
        return result.returncode, result.stdout + result.stderr

    if run_ros2("-h")[0] and "No module named 'ros2cli'" in run_ros2("-h")[1]:
        pytest.skip("no ros2cli: source a ROS 2 that contains ros2cli, or set SHMGEN_ROS2CLI to its folder")
    assert run(["pub", topic, "std_msgs/Int32", "data: -7", "--once"], tmp_path).code == 0
    assert run_ros2("shm", "echo", topic, "--once") == (0, "data: -7\n---\n")
    assert run_ros2("shm", "topics", "--json")[1].count(topic) == 1
    code, text = run_ros2("shm", "echo", "-h")
    assert (code, text.splitlines()[0]) == (0, "Usage: ros2 shm echo [OPTIONS] TOPIC")
    code, text = run_ros2("shm", "hz")
    assert (code, "Error: Missing argument 'TOPIC'." in text) == (2, True)
    assert re.search("^ *shm +Look at shared memory between ROS and PLCs", run_ros2()[1], re.MULTILINE)
