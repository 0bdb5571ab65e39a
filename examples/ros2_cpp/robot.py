"""A robot that comes nearer and then falls silent, and reads the belt's speed: rclpy, and nothing of shmgen."""

import sys
import time

import rclpy
from geometry_msgs.msg import PointStamped
from std_msgs.msg import Float64

PATIENCE = 20.0  # s


def main() -> int:
    """0 if the belt slowed down as the robot came nearer, and stopped when it fell silent."""
    rclpy.init()
    node = rclpy.create_node("robot")
    position = node.create_publisher(PointStamped, "/ros2_cpp/robot", 10)
    newest: list[float] = []
    node.create_subscription(Float64, "/ros2_cpp/speed", lambda message: newest.append(message.data), 10)

    def settled(x: float | None, wanted: float) -> float:
        """The speed once it is as expected, or after all patience."""
        deadline = time.monotonic() + PATIENCE
        while time.monotonic() < deadline and newest[-1:] != [wanted]:
            if x is not None:
                message = PointStamped()
                message.point.x = x
                position.publish(message)
            rclpy.spin_once(node, timeout_sec=0.05)
        return newest[-1] if newest else -1.0

    speeds = []
    for x, wanted in ((3.0, 1.2), (1.0, 0.6), (0.25, 0.15), (None, 0.0)):
        speeds.append(settled(x, wanted))
        print(f"   robot at {x} m, belt at {speeds[-1]:g} m/s" if x else "   the robot says nothing more", flush=True)
    print(f"   the belt ran at {', '.join(f'{speed:g}' for speed in speeds)} m/s", flush=True)
    return 0 if speeds == [1.2, 0.6, 0.15, 0.0] else 1


if __name__ == "__main__":
    sys.exit(main())
