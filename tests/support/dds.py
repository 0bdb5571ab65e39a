"""A domain of DDS on loopback, with bridges and peers in it: what support/ros1.py is for ROS 1."""

from __future__ import annotations

import os
import subprocess
import sys
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import pytest

from ..conftest import REPOSITORY
from .ros1 import Bridge

LOOPBACK = """<CycloneDDS><Domain Id="any">
  <General><AllowMulticast>false</AllowMulticast><Interfaces><NetworkInterface name="lo"/></Interfaces></General>
  <Discovery><ParticipantIndex>auto</ParticipantIndex><MaxAutoParticipantIndex>9</MaxAutoParticipantIndex>
    <Peers><Peer address="127.0.0.1"/></Peers></Discovery>
</Domain></CycloneDDS>"""
"""Cyclone's configuration: no other machine hears the tests, and none is heard."""


def without_fast_dds() -> None:
    """Skips what wants the bridge's part of Fast DDS."""
    pytest.importorskip("shmgen_fastdds", reason="no shmgen-fastdds: `make test-all` installs it where Fast DDS is")


def this_machine() -> str:
    """The same by an interface of this machine, if it has one: with LOCALHOST, Fast DDS has no other."""
    try:
        from shmgen_fastdds import addresses
    except ImportError:
        return LOOPBACK
    address = (addresses() or ["127.0.0.1"])[0]
    return LOOPBACK.replace('name="lo"', f'address="{address}"').replace("127.0.0.1", address)


class Domain:
    """Processes in a folder for shmgen.toml, all of one domain."""

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
        """`shmgen bridge` in the folder, ready."""
        if config:
            (self.folder / "shmgen.toml").write_text(config)
        bridge = Bridge(self.start([self.python, "-m", "shmgen", "bridge", "--backend", "dds"], stderr=-2))
        bridge.said("^running")
        return bridge

    def start(self, command: list[Any], more: Mapping[str, str] | None = None, **streams: Any) -> Any:
        """A process that ends with the domain."""
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
