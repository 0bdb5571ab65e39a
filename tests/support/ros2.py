"""Real ROS 2 for the tests: rclpy of Jazzy and of Kilted, each in a separate environment that `make` creates.

The wheels on PyPI are for Linux x86-64 and made by a volunteer. Without them, the tests that need rclpy are skipped.
"""

from __future__ import annotations

import json
import os
import subprocess
import sys
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import pytest

from . import REPOSITORY
from .dds import LOOPBACK
from .ros1 import Bridge, Peer

DISTRIBUTIONS = ("jazzy", "kilted")


def prefix(distribution: str) -> Path:
    """Return an ament prefix that is also a Python environment."""
    result = REPOSITORY / ".venv" / f"ros2-{distribution}"
    if not (result / "share" / "rclpy").is_dir():
        pytest.skip(f"no wheels of ROS 2 {distribution}: `make test-all` installs them where there are any")
    return result


def hashes(distribution: str) -> dict[str, str]:
    """Return the type hash of each installed message, and of each part of a service or action, by full name."""
    result: dict[str, str] = {}
    for file in prefix(distribution).glob("share/*/*/*.json"):
        if file.parent.name in ("msg", "srv", "action"):
            data = json.loads(file.read_text())
            result |= {entry["type_name"]: entry["hash_string"] for entry in data.get("type_hashes", ())}
    return result


class Graph:
    """Processes of one domain on one machine, in a folder with shmgen.toml, like support/ros1.py for ROS 1."""

    plain = (("echo", "rclpy echo"),)
    load_peer = REPOSITORY / "tests" / "ros2" / "load_peer.py"

    def __init__(self, folder: Path, number: int, distribution: str = "jazzy", backend: str = "ros2") -> None:
        self.folder = folder
        self.source = distribution
        self.prefix = prefix(distribution)
        self.python = self.prefix / "bin" / "python"
        self.backend = backend
        self.number = number
        self.processes: list[subprocess.Popen[str]] = []

    def bridge(self, config: str = "", *arguments: str, ready: bool = True) -> Bridge:
        """Start `shmgen bridge` in the folder and wait until it is ready."""
        if config:
            (self.folder / "shmgen.toml").write_text(config)
        python = sys.executable if self.backend == "dds" else self.python
        command = [python, "-m", "shmgen", "bridge", "--backend", self.backend, *arguments]
        bridge = Bridge(self.start(command, {"PYTHONPATH": str(REPOSITORY / "src")}, stderr=subprocess.STDOUT))
        if ready:
            bridge.wait_for_line("^running")
        return bridge

    def peer(self, more: Mapping[str, str] | None = None) -> Peer:
        return Peer(self.start([self.python, REPOSITORY / "tests" / "ros2" / "peer.py"], more, stdin=-1))

    def start(self, command: list[Any], more: Mapping[str, str] | None = None, **streams: Any) -> Any:
        environment = {
            name: value for name, value in os.environ.items() if not name.startswith(("ROS", "PYTHON", "RMW"))
        }
        environment |= {
            "ROS_DOMAIN_ID": str(self.number),
            "ROS_AUTOMATIC_DISCOVERY_RANGE": "LOCALHOST",
            "ROS_LOG_DIR": str(self.folder / "log"),
            "AMENT_PREFIX_PATH": str(self.prefix),
            "ROS_VERSION": "2",
            "PYTHONUNBUFFERED": "1",
            **(more or {}),
        }
        if self.backend == "dds" and "shmgen" in command:
            environment |= {"CYCLONEDDS_URI": LOOPBACK}
        with (self.folder / "errors").open("a") as errors:
            settings = {"cwd": self.folder, "env": environment, "stdout": -1, "stderr": errors, "text": True}
            process = subprocess.Popen([str(word) for word in command], **(settings | streams))
        self.processes.append(process)
        return process

    def close(self) -> None:
        for process in self.processes:
            process.kill()
        for process in self.processes:
            process.communicate()
