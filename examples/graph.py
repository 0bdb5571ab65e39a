"""A ROS 1 graph for demos: a separate master, and `rostopic` to play the robot and read the belt's speed."""

from __future__ import annotations

import os
import socket
import subprocess
import time
from contextlib import ExitStack
from pathlib import Path

REPOSITORY = Path(__file__).parents[1]
PYTHON = REPOSITORY / ".venv" / "ros1" / "bin" / "python"
SETTLE = 1.5  # s until a publisher is connected and the belt has reacted
FORGET = 3.0  # s until the bridge and the PLC treat a silent robot as gone


class Ros:
    """Starts processes of ROS 1 with a master of their own, to which `environment` points.

    `robot` and `speed` are the topics of the robot's pose and of the belt's speed.
    """

    def __init__(self, processes: ExitStack, robot: str, speed: str) -> None:
        self._robot, self._speed = robot, speed
        with socket.socket() as probe:
            probe.bind(("127.0.0.1", 0))
            self.port = probe.getsockname()[1]
        self._processes = processes
        self.environment = {
            **os.environ,
            "ROS_MASTER_URI": f"http://127.0.0.1:{self.port}",
            "ROS_IP": "127.0.0.1",
            "PYTHONUNBUFFERED": "1",
            "PYTHONWARNINGS": "ignore",
            "PYTHONPATH": str(REPOSITORY / "src"),
        }

    def start(self, module: str, function: str, *arguments: str, label: str = "") -> subprocess.Popen[str]:
        """Start a command of ROS 1, given as a Python module and function, and print `label`. The demo ends it."""
        if label:
            print(f"\n$ {label}", flush=True)
        name = label.partition(" ")[0] or module
        code = f"import sys, {module}; sys.argv[0] = {name!r}; {module}.{function}()"
        command = [str(PYTHON), "-c", code, *arguments]
        process = subprocess.Popen(
            command, env=self.environment, stdout=subprocess.PIPE, stderr=subprocess.DEVNULL, text=True
        )
        self._processes.callback(process.wait)
        self._processes.callback(process.terminate)
        return process

    def speed_with_robot_at(self, x: float) -> float:
        """Publish the pose of a robot at `x` m for some time, and return the belt's speed in m/s at the end."""
        values = f"{{point: {{x: {x}}}}}"
        label = f"rostopic pub -r 20 {self._robot} geometry_msgs/PointStamped '{values}'"
        pub = self.start(
            "rostopic",
            "rostopicmain",
            "pub",
            "-r",
            "20",
            self._robot,
            "geometry_msgs/PointStamped",
            values,
            label=label,
        )
        time.sleep(SETTLE)
        speed = self.speed()
        pub.terminate()
        return speed

    def speed(self) -> float:
        """Return the next published speed of the belt in m/s."""
        echo = self.start(
            "rostopic", "rostopicmain", "echo", "-n", "1", self._speed, label=f"rostopic echo -n 1 {self._speed}"
        )
        text = echo.communicate(timeout=30)[0]
        print(f"   {text.splitlines()[0]}", flush=True)
        return float(text.split()[1])
