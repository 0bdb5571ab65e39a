"""Publishes a pose that moves on a circle, 100 times a second, until the process is stopped."""

from __future__ import annotations

import math
import sys
import time

from shm_msgs.geometry_msgs.msg import Point, Pose, PosePublisher, Quaternion

RADIUS = 2.0  # m
TURN = 4.0  # s for one turn


def pose_at(seconds: float) -> Pose:
    """Return the robot's pose at a time in seconds. The robot heads along the circle."""
    angle = 2 * math.pi * seconds / TURN
    heading = angle + math.pi / 2
    return Pose(
        position=Point(x=RADIUS * math.cos(angle), y=RADIUS * math.sin(angle), z=0.0),
        orientation=Quaternion(z=math.sin(heading / 2), w=math.cos(heading / 2)),
    )


def main(topic: str) -> None:
    start = time.monotonic()
    with PosePublisher(topic) as publisher:
        while True:
            publisher.publish(pose_at(time.monotonic() - start))
            time.sleep(0.01)


if __name__ == "__main__":
    main(sys.argv[1])
