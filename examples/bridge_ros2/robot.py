"""A ROS 2 node that publishes the robot's position and reads the feeder's speed. It contains no shmgen code."""

import sys
import time

import rclpy
from geometry_msgs.msg import PoseStamped
from rclpy.qos import DurabilityPolicy, QoSProfile
from std_msgs.msg import Float64

TIMEOUT = 20.0  # s, for each speed
LATCHED = QoSProfile(depth=1, durability=DurabilityPolicy.TRANSIENT_LOCAL)


def main() -> int:
    """Move towards the feeder. Return 0 if its speed followed the robot, and it stopped after the last message."""
    rclpy.init()
    node = rclpy.create_node("robot")
    pose = node.create_publisher(PoseStamped, "/feeder/robot", 10)
    speeds: list[float] = []
    node.create_subscription(Float64, "/feeder/speed", lambda message: speeds.append(message.data), LATCHED)

    def wait_for_speed(speed: float, x: float | None) -> bool:
        """Wait until the feeder has the speed `speed`. Return False on timeout.

        If `x` is given, publish the robot's position meanwhile.
        """
        deadline = time.monotonic() + TIMEOUT
        while speeds[-1:] != [speed] and time.monotonic() < deadline:
            if x is not None:
                message = PoseStamped()
                message.header.stamp = node.get_clock().now().to_msg()
                message.pose.position.x = x
                pose.publish(message)
            rclpy.spin_once(node, timeout_sec=0.05)
        state = "the robot sends nothing" if x is None else f"the robot is at {x:g} m"
        print(f"   {state}: the feeder runs at {speeds[-1] if speeds else '?'} m/s", flush=True)
        return speeds[-1:] == [speed]

    done = [wait_for_speed(x / 2, x) for x in (3.0, 1.0, 0.5)] + [wait_for_speed(0.0, None)]
    print(f"   {sum(done)} of 4 as expected", flush=True)
    node.destroy_node()
    rclpy.shutdown()
    return 0 if all(done) else 1


if __name__ == "__main__":
    sys.exit(main())
