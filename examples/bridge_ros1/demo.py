"""A PLC in a ROS 1 graph: a master, `shmgen bridge`, a program in Structured Text, and `rostopic` to look at it.

Needs Debian's ROS 1, which `make test-all` sets up. The master is one of its own, so no other graph is disturbed.
"""

from __future__ import annotations

import os
import socket
import subprocess
import sys
import time
from contextlib import ExitStack
from pathlib import Path

HERE = Path(__file__).parent
REPOSITORY = HERE.parents[1]
PYTHON = REPOSITORY / ".venv" / "ros1" / "bin" / "python"
ROBOT, SPEED = "/shmgen_demo/robot", "/shmgen_demo/speed"
SETTLE = 1.5  # s for a publisher to connect and the belt to follow
FORGET = 3.0  # s after which the bridge, and then the PLC, takes a silent robot for gone
sys.path.insert(0, str(HERE.parent))

from stage import cell  # noqa: E402 it lies beside the examples


def main() -> int:
    """0 if the belt slowed down as the robot came nearer, and stopped when it fell silent."""
    if not PYTHON.exists():
        sys.exit(f"{PYTHON} is not there: `make test-all` as root installs Debian's ROS 1 and makes it")
    with cell(HERE) as made, ExitStack() as processes:
        made.generate()
        print("\nThe PLC: PRG_Belt.st and what was generated, compiled and called every millisecond", flush=True)
        made.start_plc("PRG_Belt")
        ros = Ros(processes)
        ros.start("rosmaster", "rosmaster_main", "--core", "-p", str(ros.port))
        bridge = ros.start("shmgen.__main__", "main", "bridge", "-c", str(HERE / "shmgen.toml"), shown="shmgen bridge")
        for line in bridge.stdout or ():
            print(f"   {line.rstrip()}", flush=True)
            if line.startswith("running"):
                break
        speeds = [ros.speed_with_robot_at(x) for x in (3.0, 1.0, 0.25)]
        time.sleep(FORGET)
        print("\n   the robot says nothing more", flush=True)
        speeds.append(ros.speed())
    print(f"\n   the belt ran at {', '.join(f'{speed:g}' for speed in speeds)} m/s", flush=True)
    return 0 if speeds == [1.2, 0.6, 0.15, 0.0] else 1


class Ros:
    """Processes of ROS 1 around a master of their own."""

    def __init__(self, processes: ExitStack) -> None:
        with socket.socket() as probe:
            probe.bind(("127.0.0.1", 0))
            self.port = probe.getsockname()[1]
        self._processes = processes
        self._environment = {
            **os.environ,
            "ROS_MASTER_URI": f"http://127.0.0.1:{self.port}",
            "ROS_IP": "127.0.0.1",
            "PYTHONUNBUFFERED": "1",
            "PYTHONWARNINGS": "ignore",
            "PYTHONPATH": str(REPOSITORY / "src"),
        }

    def start(self, module: str, function: str, *arguments: str, shown: str = "") -> subprocess.Popen[str]:
        """A command of ROS as the Python function it is, so that it runs in that Python; ends with the demo."""
        if shown:
            print(f"\n$ {shown}", flush=True)
        name = shown.partition(" ")[0] or module
        code = f"import sys, {module}; sys.argv[0] = {name!r}; {module}.{function}()"
        command = [str(PYTHON), "-c", code, *arguments]
        process = subprocess.Popen(
            command, env=self._environment, stdout=subprocess.PIPE, stderr=subprocess.DEVNULL, text=True
        )
        self._processes.callback(process.wait)
        self._processes.callback(process.terminate)
        return process

    def speed_with_robot_at(self, x: float) -> float:
        values = f"{{point: {{x: {x}}}}}"
        shown = f"rostopic pub -r 20 {ROBOT} geometry_msgs/PointStamped '{values}'"
        pub = self.start(
            "rostopic", "rostopicmain", "pub", "-r", "20", ROBOT, "geometry_msgs/PointStamped", values, shown=shown
        )
        time.sleep(SETTLE)
        speed = self.speed()
        pub.terminate()
        return speed

    def speed(self) -> float:
        echo = self.start("rostopic", "rostopicmain", "echo", "-n", "1", SPEED, shown=f"rostopic echo -n 1 {SPEED}")
        text = echo.communicate(timeout=30)[0]
        print(f"   {text.splitlines()[0]}", flush=True)
        return float(text.split()[1])


if __name__ == "__main__":
    sys.exit(main())
