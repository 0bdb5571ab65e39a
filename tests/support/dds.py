"""A DDS domain on loopback with bridges and peers, like support/ros1.py for ROS 1."""

from __future__ import annotations

import os
import subprocess
import sys
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from . import REPOSITORY, import_or_skip
from .ros1 import Bridge

LOOPBACK = """<CycloneDDS><Domain Id="any">
  <General><AllowMulticast>false</AllowMulticast><Interfaces><NetworkInterface name="lo"/></Interfaces></General>
  <Discovery><ParticipantIndex>auto</ParticipantIndex><MaxAutoParticipantIndex>9</MaxAutoParticipantIndex>
    <Peers><Peer address="127.0.0.1"/></Peers></Discovery>
</Domain></CycloneDDS>"""
"""Cyclone's configuration: the tests neither send to other machines nor receive from them."""


def without_fast_dds() -> None:
    """Skip the test if the package shmgen-fastdds is not installed."""
    import_or_skip("shmgen_fastdds", reason="no shmgen-fastdds: `make test-all` installs it where Fast DDS is")


def this_machine() -> str:
    """Return LOOPBACK with a network interface instead of `lo`, because Fast DDS uses one even with LOCALHOST."""
    try:
        from shmgen_fastdds import addresses
    except ImportError:
        return LOOPBACK
    address = (addresses() or ["127.0.0.1"])[0]
    return LOOPBACK.replace('name="lo"', f'address="{address}"').replace("127.0.0.1", address)


class Domain:
    """Processes of one DDS domain, in a folder with shmgen.toml."""

    source = "jazzy"
    plain = (("echo", "cyclonedds echo"), ("bytes", "the same, bytes only"))
    load_peer = REPOSITORY / "tests" / "dds" / "load_peer.py"

    def __init__(self, folder: Path, number: int) -> None:
        self.folder = folder
        self.python = sys.executable
        self.environment = {
            **os.environ,
            "CYCLONEDDS_URI": LOOPBACK,
            "ROS_DOMAIN_ID": str(number),
            "PYTHONPATH": f"{REPOSITORY / 'src'}:{REPOSITORY}",
            "PYTHONUNBUFFERED": "1",
        }
        self.processes: list[subprocess.Popen[str]] = []

    def bridge(self, config: str = "") -> Bridge:
        """Start `shmgen bridge` in the folder and wait until it is ready."""
        if config:
            (self.folder / "shmgen.toml").write_text(config)
        bridge = Bridge(self.start([self.python, "-m", "shmgen", "bridge", "--backend", "dds"], stderr=-2))
        bridge.wait_for_line("^running")
        return bridge

    def start(self, command: list[Any], more: Mapping[str, str] | None = None, **streams: Any) -> Any:
        """Start a process that close() ends."""
        words = [str(word) for word in command]
        settings = {"cwd": self.folder, "env": {**self.environment, **(more or {})}, "stdout": -1, "text": True}
        process = subprocess.Popen(words, **(settings | streams))
        self.processes.append(process)
        return process

    def close(self) -> None:
        for process in self.processes:
            process.kill()
        for process in self.processes:
            process.communicate()
