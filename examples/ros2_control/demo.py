"""Uses a PLC as hardware of ros2_control, in a loop at 1 kHz with a ResourceManager, and kills the PLC meanwhile.

Needs a sourced ROS 2 with hardware_interface.
"""

from __future__ import annotations

import json
import subprocess
import sys
import time
from pathlib import Path
from xml.etree import ElementTree

HERE = Path(__file__).parent
sys.path.insert(0, str(HERE.parent))

from rclcpp import build, needs  # noqa: E402 both modules are in examples/
from stage import cell  # noqa: E402

CYCLES = 3000


def main() -> int:
    """Run the demo. Return 0 if all positions came back, and the loop reported the killed PLC as an error."""
    needs("hardware_interface")
    with cell(HERE, "blark") as here:
        here.generate()
        build(here, HERE)
        install = build(here, here.folder / "ros2_control" / "arm_control")
        robot = here.folder / "robot.urdf"
        robot.write_text(urdf(install / "share" / "arm_control" / "urdf" / "plc.ros2_control.xacro"))
        plc = here.start_plc("PRG_Arm")
        command = [install / "bin" / "loop", robot, str(CYCLES), "1"]
        done = subprocess.run(command, env=here.environment, capture_output=True, text=True, timeout=120, check=False)
        counts = json.loads(done.stdout.splitlines()[-1])
        p50, p99, most = counts["cycle_us"]
        wrong = f"{counts['wrong_positions']} wrong positions"
        delays = f"{p50} us (median), {p99} us (99 %), {most} us (longest)"
        print(f"\n   {counts['good_cycles']} cycles, {wrong}; from read to write: {delays}")
        command[2] = "1000000"
        loop = subprocess.Popen(
            command, env=here.environment, stdout=subprocess.PIPE, stderr=subprocess.DEVNULL, text=True
        )
        time.sleep(2)
        plc.kill()
        last = json.loads(loop.communicate(timeout=20)[0].splitlines()[-1])
        print(f"   the PLC killed: `{last['failed_call']}` is an error in cycle {last['good_cycles'] + 1}", flush=True)
    return 0 if (counts["good_cycles"], counts["wrong_positions"], last["failed_call"]) == (CYCLES, 0, "read") else 1


def urdf(snippet: Path) -> str:
    """Return a URDF with six joints and the generated ros2_control section."""
    robot = '<robot name="arm"><link name="link0"/>'
    for joint in range(1, 7):
        limit = '<limit lower="-1e9" upper="1e9" velocity="1" effort="1"/>'
        ends = f'<parent link="link{joint - 1}"/><child link="link{joint}"/>'
        robot += f'<link name="link{joint}"/><joint name="joint{joint}" type="revolute">{ends}{limit}</joint>'
    control = ElementTree.parse(snippet).getroot().find("ros2_control")
    assert control is not None
    return f"{robot}{ElementTree.tostring(control, encoding='unicode')}</robot>"


if __name__ == "__main__":
    sys.exit(main())
