"""`ros2 shm`: the ros2 command line finds the command by its entry point, and all words are shmgen's."""

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


def asked(words: Sequence[str]) -> list[str]:
    """What shmgen gets of `ros2 shm words…`, as ros2cli parses a command line: a parser in a parser."""
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
def test_every_word_reaches_shmgen(words: str) -> None:
    assert asked(words.split()) == words.split()


def test_the_ros2_command_line_itself(tmp_path: Path, topic: str) -> None:
    """ros2cli is in no package index; SHMGEN_ROS2CLI names a folder to import it from, a sourced ROS has it."""
    python = ros2.prefix("jazzy") / "bin" / "python"
    folders = [os.environ.get("SHMGEN_ROS2CLI", ""), os.environ.get("PYTHONPATH", "")]
    environment = {**os.environ, "PYTHONPATH": ":".join(filter(None, folders))}

    def said(*words: str) -> tuple[int, str]:
        code = "import sys; from ros2cli.cli import main; sys.argv[0] = 'ros2'; sys.exit(main())"
        command = [python, "-c", code, *words]
        done = subprocess.run(command, env=environment, cwd=tmp_path, capture_output=True, text=True, check=False)
        return done.returncode, done.stdout + done.stderr

    if said("-h")[0] and "No module named 'ros2cli'" in said("-h")[1]:
        pytest.skip("no ros2cli: source a ROS 2 that has it, or name the folder that it is in in SHMGEN_ROS2CLI")
    assert run(["pub", topic, "std_msgs/Int32", "data: -7", "--once"], tmp_path).code == 0
    assert said("shm", "echo", topic, "--once") == (0, "data: -7\n---\n")
    assert said("shm", "topics", "--json")[1].count(topic) == 1
    code, text = said("shm", "echo", "-h")
    assert (code, text.splitlines()[0]) == (0, "Usage: ros2 shm echo [OPTIONS] TOPIC")
    code, text = said("shm", "hz")
    assert (code, "Error: Missing argument 'TOPIC'." in text) == (2, True)
    assert re.search("^ *shm +Look at shared memory between ROS and PLCs", said()[1], re.MULTILINE)
