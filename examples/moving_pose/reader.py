"""Prints a pose every quarter of a second, draws the path, and ends after one turn."""

from __future__ import annotations

import math
import os
import sys
import time

from shm_msgs.geometry_msgs.msg import Pose, PoseSubscriber

SAMPLES = 400
PRINT_EACH = 25
WIDTH, HEIGHT = 33, 13


def main(topic: str) -> int:
    seen: list[Pose] = []
    with PoseSubscriber(topic) as subscriber:
        print(f"   reader is process {os.getpid()}; sample, position [m], yaw [deg], age")
        deadline = time.monotonic() + 90
        while len(seen) < SAMPLES and time.monotonic() < deadline:
            pose = subscriber.wait(timeout=1.0)
            if pose is None:
                continue
            seen.append(pose)
            if len(seen) % PRINT_EACH == 1:
                yaw = math.degrees(2 * math.atan2(pose.orientation.z, pose.orientation.w)) % 360
                age = (subscriber.age or 0.0) * 1e6
                print(
                    f"   #{subscriber.sequence:<4} x {pose.position.x:+.2f}  y {pose.position.y:+.2f}"
                    f"  yaw {yaw:5.1f}  {age:5.0f} us"
                )
        print(draw(seen))
        print(f"   {len(seen)} poses received, {subscriber.missed} missed")
    return 0 if len(seen) == SAMPLES else 1


def draw(poses: list[Pose]) -> str:
    """Return a drawing of the path from above, two metres around the origin."""
    canvas = [[" "] * WIDTH for _ in range(HEIGHT)]
    for pose in poses:
        column = round((pose.position.x + 2.2) / 4.4 * (WIDTH - 1))
        row = round((2.2 - pose.position.y) / 4.4 * (HEIGHT - 1))
        canvas[row][column] = "o"
    canvas[HEIGHT // 2][WIDTH // 2] = "+"
    return "\n".join("   " + "".join(line).rstrip() for line in canvas)


if __name__ == "__main__":
    sys.exit(main(sys.argv[1]))
