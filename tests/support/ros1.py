"""A real ROS 1 on loopback: rosmaster on its own port, bridges, rospy peers, and the commands of ros_comm.

Debian's packages work with /usr/bin/python3 only. So `make` creates an environment of this Python at .venv/ros1, with
shmgen's dependencies and the system's packages. Without this environment, the tests are skipped.
"""

from __future__ import annotations

import json
import os
import random
import re
import signal
import socket
import subprocess
import sys
import threading
import time
from collections.abc import Mapping
from contextlib import suppress
from pathlib import Path
from typing import Any

import pytest

from . import REPOSITORY

LIMIT = 90.0
"""The time limit in seconds for an expected event."""
PROMPTLY = 5.0
"""The time limit in seconds for the end of a bridge on a busy machine. A quiet machine takes 0.5 s."""


def python() -> Path:
    """Return a Python that has rospy and the dependencies of shmgen."""
    own = REPOSITORY / ".venv" / "ros1" / "bin" / "python"
    for interpreter in (own, Path(sys.executable)):
        if interpreter.exists() and not subprocess.call(
            [interpreter, "-c", "import rospy, click"], stderr=subprocess.DEVNULL
        ):
            return interpreter
    pytest.skip("no rospy: `make test-all` as root installs Debian's packages and makes .venv/ros1")


class Graph:
    """A ROS graph whose master can be restarted, with a folder for logs and shmgen.toml. Only peers use `modules`."""

    source = "noetic"
    plain = (("echo", "rospy echo"),)
    load_peer = REPOSITORY / "tests" / "bridge" / "load_peer.py"

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        self.python = python()
        self.port = free_port()
        self.modules = folder / "modules"
        self.processes: list[subprocess.Popen[str]] = []
        self.master = self.start_master()

    def start_master(self) -> subprocess.Popen[str]:
        code = f"import rosmaster; rosmaster.rosmaster_main(['rosmaster', '--core', '-p', '{self.port}'])"
        self.master = self.start([self.python, "-c", code])
        wait_for(lambda: _answers(self.port), "the master")
        return self.master

    def stop_master(self) -> None:
        self.master.kill()
        self.master.wait()

    def bridge(self, config: str = "", *arguments: str, ready: bool = True) -> Bridge:
        """Start `shmgen bridge` in the folder."""
        if config:
            (self.folder / "shmgen.toml").write_text(config)
        command = [self.python, "-m", "shmgen", "bridge", "--backend", "ros1", *arguments]
        bridge = Bridge(self.start(command, {"PYTHONPATH": str(REPOSITORY / "src")}, stderr=subprocess.STDOUT))
        if ready:
            bridge.wait_for_line("running")
        return bridge

    def peer(self) -> Peer:
        return Peer(self.start([self.python, REPOSITORY / "tests" / "bridge" / "peer.py"], self.seen, stdin=-1))

    def command(self, *words: str) -> subprocess.Popen[str]:
        """Start a command such as `rostopic …` or `rosservice …`."""
        tool, *arguments = words
        code = f"import sys, {tool}; sys.argv[0] = '{tool}'; {tool}.{tool}main()"
        return self.start([self.python, "-c", code, *arguments], self.seen)

    @property
    def seen(self) -> dict[str, str]:
        return {"PYTHONPATH": str(self.modules)}

    def start(self, command: list[Any], more: Mapping[str, str] | None = None, **streams: Any) -> Any:
        environment = {name: value for name, value in os.environ.items() if not name.startswith(("ROS", "PYTHON"))}
        environment |= {
            "ROS_MASTER_URI": f"http://127.0.0.1:{self.port}",
            "ROS_IP": "127.0.0.1",
            "ROS_HOME": str(self.folder / "ros"),
            "PYTHONUNBUFFERED": "1",
            "PYTHONWARNINGS": "ignore",
            **(more or {}),
        }
        with (self.folder / "log").open("a") as log:
            settings = {"cwd": self.folder, "env": environment, "stdout": subprocess.PIPE, "stderr": log, "text": True}
            process = subprocess.Popen([str(word) for word in command], **(settings | streams))
        self.processes.append(process)
        return process

    def generate(self, package: str, files: Mapping[str, str]) -> None:
        """Generate Python modules for peers from .msg and .srv files with genpy, as catkin would."""
        code = """
import sys, genpy.generator, genpy.generate_initpy
package, folder, out = sys.argv[1:4]
for kind, make in (("msg", genpy.generator.MsgGenerator), ("srv", genpy.generator.SrvGenerator)):
    files = [file for file in sys.argv[4:] if file.endswith("." + kind)]
    if files:
        path = {package: [folder + "/msg"], "std_msgs": ["/usr/share/std_msgs/msg"]}
        assert not make().generate_messages(package, files, f"{out}/{package}/{kind}", path)
        genpy.generate_initpy.write_modules(f"{out}/{package}/{kind}")
genpy.generate_initpy.write_modules(f"{out}/{package}")
"""
        folder = self.folder / "msgs" / package
        for name, text in files.items():
            (folder / name).parent.mkdir(parents=True, exist_ok=True)
            (folder / name).write_text(text)
        (self.modules / package).mkdir(parents=True)
        command = [self.python, "-c", code, package, folder, self.modules, *(str(folder / name) for name in files)]
        subprocess.run(command, check=True)

    def close(self) -> None:
        for process in self.processes:
            process.kill()
        for process in self.processes:
            process.communicate()


class Bridge:
    """A process of `shmgen bridge` and its output lines."""

    def __init__(self, process: subprocess.Popen[str]) -> None:
        self.process = process
        self.lines: list[str] = []
        threading.Thread(target=self._read, daemon=True).start()

    def wait_for_line(self, pattern: str, times: int = 1) -> str:
        """Wait until enough output lines match, and return the first of them."""

        def matches() -> list[str]:
            return [line for line in list(self.lines) if re.search(pattern, line)]

        wait_for(lambda: len(matches()) >= times, f"{pattern!r}", lambda: "".join(self.lines))
        return matches()[0]

    def counted(self, pattern: str) -> None:
        """Wait until a line with counters ends with `pattern`."""

        def is_counted() -> bool:
            self.process.send_signal(signal.SIGUSR1)
            time.sleep(0.05)
            return any(re.search(f"{pattern}$", line) for line in list(self.lines))

        wait_for(is_counted, f"a count of {pattern!r}", lambda: "".join(self.lines))

    def stop(self, number: int) -> float:
        """Send a signal. Return the time in seconds until the bridge ended with exit code 0."""
        begun = time.monotonic()
        self.process.send_signal(number)
        assert self.process.wait(LIMIT) == 0, "".join(self.lines)
        return time.monotonic() - begun

    def kill(self) -> None:
        self.process.kill()
        self.process.wait()

    def _read(self) -> None:
        assert self.process.stdout
        with suppress(ValueError):  # closed by who has ended the process
            for line in self.process.stdout:
                self.lines.append(line)


class Peer:
    """A node (tests/bridge/peer.py) that executes requests of the test."""

    def __init__(self, process: subprocess.Popen[str]) -> None:
        self.process = process

    def ask(self, **command: Any) -> Any:
        assert self.process.stdin
        assert self.process.stdout
        self.process.stdin.write(json.dumps(command) + "\n")
        self.process.stdin.flush()
        return json.loads(self.process.stdout.readline() or '"the peer has died"')


def wait_for(condition: Any, what: str, more: Any = lambda: "") -> Any:
    """Poll until the condition is true, and return its value."""
    deadline = time.monotonic() + LIMIT
    while not (value := condition()):
        assert time.monotonic() < deadline, f"{what} did not come within {LIMIT} s\n{more()}"
        time.sleep(0.02)
    return value


def free_port() -> int:
    """Return a free port below those that the kernel gives to connections, so that none of these takes it meanwhile."""
    while True:
        port = random.SystemRandom().randrange(20_000, 32_000)
        with socket.socket() as probe, suppress(OSError):
            probe.bind(("127.0.0.1", port))
            return port


def _answers(port: int) -> bool:
    with socket.socket() as probe:
        return probe.connect_ex(("127.0.0.1", port)) == 0
