"""A ROS 2 node on rmw_zenoh for a machine without ROS 2, with zenoh-ros2-sdk. It contains no shmgen code."""

import os
import queue
import sys

from zenoh_ros2_sdk import ROS2Publisher, ROS2Subscriber

FLOAT64 = {"msg_type": "std_msgs/msg/Float64", "msg_definition": "float64 data"}
TIMEOUT = 20  # s; timeout of the discovery


def main() -> int:
    """Send setpoints. Return 0 once the PLC has answered each setpoint."""
    actual: queue.Queue[float] = queue.Queue()
    ROS2Subscriber("/drive/actual", callback=lambda message: actual.put(message.data), **FLOAT64)
    setpoint = ROS2Publisher("/drive/setpoint", **FLOAT64)
    for _ in range(TIMEOUT * 5):  # until the bridge has discovered this node
        setpoint.publish(data=0.0)
        try:
            actual.get(timeout=0.2)
            break
        except queue.Empty:
            continue
    for number in range(1, 6):
        while not actual.empty():
            actual.get()
        setpoint.publish(data=float(number))
        reached = actual.get(timeout=TIMEOUT)
        print(f"   setpoint {number:g}       PLC: {reached:g}", flush=True)
        if reached != number / 2:
            return 1
    print("   5 setpoints: the drive reached half of each", flush=True)
    return 0


if __name__ == "__main__":
    status = main()
    sys.stdout.flush()
    os._exit(status)  # skip waiting for zenoh's threads
