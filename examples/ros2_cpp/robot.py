"""A robot that approaches, then stops publishing, and reads the belt's speed. It uses rclpy and no shmgen code."""

import sys
import time

import rclpy
from geometry_msgs.msg import PointStamped
from std_msgs.msg import Float64

TIMEOUT = 20.0  # s, for each speed


def main() -> int:
    """Move to the belt. Return 0 if it slowed down, and stopped when the robot stopped publishing."""
    rclpy.init()
    node = rclpy.create_node("robot")
    position = node.create_publisher(PointStamped, "/ros2_cpp/robot", 10)
    newest: list[float] = []
    node.create_subscription(Float64, "/ros2_cpp/speed", lambda message: newest.append(message.data), 10)

    def wait_for_speed(x: float | None, expected: float) -> float:
        """Wait until the belt's speed is `expected`, and return it. If `x` is given, publish the robot's position.

        After the timeout, return the speed at that time.
        """
        deadline = time.monotonic() + TIMEOUT
        while time.monotonic() < deadline and newest[-1:] != [expected]:
            if x is not None:
                message = PointStamped()
                message.point.x = x
                position.publish(message)
            rclpy.spin_once(node, timeout_sec=0.05)
        return newest[-1] if newest else -1.0

    speeds = []
    for x, expected in ((3.0, 1.2), (1.0, 0.6), (0.25, 0.15), (None, 0.0)):
        speeds.append(wait_for_speed(x, expected))
        print(f"   robot at {x} m, belt at {speeds[-1]:g} m/s" if x else "   the robot stops sending", flush=True)
    print(f"   the belt ran at {', '.join(f'{speed:g}' for speed in speeds)} m/s", flush=True)
    return 0 if speeds == [1.2, 0.6, 0.15, 0.0] else 1


if __name__ == "__main__":
    sys.exit(main())
