"""A router of zenoh on loopback, with bridges and peers at it: what support/ros1.py is for ROS 1.

The peer is PyPI's zenoh-ros2-sdk (ROBOTIS), which speaks rmw_zenoh's wire and knows nothing of shmgen.
"""

from __future__ import annotations

import os
import subprocess
import sys
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from ..conftest import REPOSITORY
from .ros1 import Bridge, Peer, free_port

ROUTER = """
import sys, zenoh
config = zenoh.Config()
config.insert_json5("mode", '"router"')
config.insert_json5("listen/endpoints", f'["tcp/127.0.0.1:{sys.argv[1]}"]')
config.insert_json5("scouting/multicast/enabled", "false")
session = zenoh.open(config)
print("ready", flush=True)
sys.stdin.read()
"""
NODE = 'connect/endpoints=["tcp/127.0.0.1:{port}"];listen/endpoints=["tcp/127.0.0.1:0"]'


class Graph:
    """Processes in a folder for shmgen.toml, all at one router; `definitions` is an ament prefix's share, or alike."""

    source = "jazzy"
    plain = (("echo", "zenoh echo, bytes only"),)
    load_peer = REPOSITORY / "tests" / "zenoh" / "load_peer.py"

    def __init__(self, folder: Path, number: int = 0, definitions: Path | None = None) -> None:
        self.folder, self.python, self.port = folder, sys.executable, free_port()
        self.definitions = definitions or folder / "msgs"
        self.environment = {
            **os.environ,
            "ZENOH_CONFIG_OVERRIDE": NODE.format(port=self.port),
            "ZENOH_ROS2_SDK_CACHE": str(folder / "sdk"),
            "GIT_ALLOW_PROTOCOL": "file",  # the SDK would fetch definitions from elsewhere
            "ROS_DOMAIN_ID": str(number),
            "PYTHONPATH": f"{REPOSITORY / 'src'}:{REPOSITORY}",
            "PYTHONUNBUFFERED": "1",
        }
        self.processes: list[subprocess.Popen[str]] = []

    def router(self) -> subprocess.Popen[str]:
        self._router = made = self.start([self.python, "-c", ROUTER, self.port], stdin=-1)
        assert made.stdout.readline() == "ready\n"
        return made

    start_master = router

    def stop_master(self) -> None:
        self._router.kill()
        self._router.communicate()
        self.processes.remove(self._router)

    def bridge(self, config: str = "", ready: bool = True) -> Bridge:
        """`shmgen bridge` in the folder."""
        if config:
            (self.folder / "shmgen.toml").write_text(config)
        bridge = Bridge(self.start([self.python, "-m", "shmgen", "bridge", "--backend", "zenoh"], stderr=-2))
        if ready:
            bridge.said("^running")
        return bridge

    def peer(self) -> Peer:
        return Peer(self.start([self.python, REPOSITORY / "tests" / "zenoh" / "peer.py", self.definitions], stdin=-1))

    def start(self, command: list[Any], more: Mapping[str, str] | None = None, **streams: Any) -> Any:
        """A process that ends with the graph."""
        with (self.folder / "errors").open("a") as errors:
            settings = {"cwd": self.folder, "env": {**self.environment, **(more or {})}, "stdout": -1, "text": True}
            process = subprocess.Popen([str(word) for word in command], **(settings | {"stderr": errors} | streams))
        self.processes.append(process)
        return process

    def close(self) -> None:
        for process in self.processes:
            process.kill()
        for process in self.processes:
            process.communicate()
