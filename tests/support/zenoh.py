"""A zenoh router on loopback with bridges and peers, like support/ros1.py for ROS 1.

The peer is PyPI's zenoh-ros2-sdk (ROBOTIS), an independent implementation of rmw_zenoh's protocol.
"""

from __future__ import annotations

import os
import subprocess
import sys
import time
from collections.abc import Mapping
from contextlib import suppress
from pathlib import Path
from typing import Any

from shmgen.live import processes

from . import REPOSITORY
from .ros1 import Bridge, Peer, free_port, wait_for

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
    """Processes of one router, in a folder with shmgen.toml. `definitions` is a folder like an ament prefix's share."""

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
        self._router = router = self.start([self.python, "-c", ROUTER, self.port], stdin=-1)
        assert router.stdout.readline() == "ready\n"
        return router

    start_master = router

    def stop_master(self) -> None:
        self._router.kill()
        self._router.communicate()
        self.processes.remove(self._router)

    def bridge(self, config: str = "", ready: bool = True) -> Bridge:
        """Start `shmgen bridge` in the folder."""
        if config:
            (self.folder / "shmgen.toml").write_text(config)
        bridge = Bridge(self.start([self.python, "-m", "shmgen", "bridge", "--backend", "zenoh"], stderr=-2))
        if ready:
            bridge.wait_for_line("^running")
        return bridge

    def peer(self) -> Peer:
        return Peer(self.start([self.python, REPOSITORY / "tests" / "zenoh" / "peer.py", self.definitions], stdin=-1))

    def start(self, command: list[Any], more: Mapping[str, str] | None = None, **streams: Any) -> Any:
        """Start a process that close() ends."""
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
        wait_for(_remove_orphans, "the end of zenoh's shared memory")


def _remove_orphans() -> bool:
    """Remove zenoh's shared memory that no process maps. A killed process leaves it until another process starts.

    Return False if a file is so new that its process may map it later.
    """
    mapped = {mapping.name for mapping in processes.look().mappings}
    are_old = True
    for file in Path("/dev/shm").glob("*.zenoh"):
        with suppress(FileNotFoundError):
            is_old = time.time() - file.stat().st_ctime >= 1.0
            are_old &= is_old or file.name in mapped
            if is_old and file.name not in mapped:
                file.unlink()
    return are_old
