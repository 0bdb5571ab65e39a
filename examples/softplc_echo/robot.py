"""A robot that walks to the belt and away again, and prints how the conveyor reacts."""

from __future__ import annotations

import math
import os
import sys
import time

from shm_msgs.conveyor_msgs.msg import ConveyorState, ConveyorStateSubscriber
from shm_msgs.geometry_msgs.msg import Point, Pose, PosePublisher

from shmgen.runtime import read_header, region_name

FARTHEST = 2.5  # m from the belt
WALK = 4.0  # s, there and back
PERIOD = 0.01  # s between two poses
ANSWER = 20.0  # s; timeout until the PLC reports the last pose, for a busy machine
PRINT_PERIOD = 0.25  # s between two printed lines
MODES = {ConveyorState.STOPPED: "stopped", ConveyorState.SLOW: "slow", ConveyorState.RUNNING: "running"}


def main(poses: str, states: str) -> int:
    """Walk to the belt and back. Return 0 if the belt stopped and ran, and the PLC accounted for nearly every pose."""
    seen: set[str] = set()
    state: ConveyorState | None = None
    print(f"   the robot is process {os.getpid()}; the lines show its distance and the belt")
    with PosePublisher(poses) as publisher, ConveyorStateSubscriber(states) as subscriber:
        start = time.monotonic()
        last_line = -1
        sent = 0
        while (now := time.monotonic() - start) < WALK:
            x = FARTHEST * (1 + math.cos(2 * math.pi * now / WALK)) / 2
            publisher.publish(Pose(position=Point(x=x)))
            sent += 1
            time.sleep(PERIOD)
            state = subscriber.read() or state
            if state is not None and now > 0.1:
                seen.add(MODES[state.mode])
                if int(now / PRINT_PERIOD) > last_line:
                    last_line = int(now / PRINT_PERIOD)
                    belt = "=" * round(20 * state.speed)
                    print(
                        f"   robot at {x:4.2f} m   belt {MODES[state.mode]:<8}{state.speed:4.2f} m/s  {belt}",
                        flush=True,
                    )
        end = time.monotonic() + ANSWER
        received = missed = 0
        while received + missed < sent and time.monotonic() < end:
            state = subscriber.wait(0.1) or state  # the report of the last pose may not have arrived
            received = state.poses if state else 0
            missed = read_header(region_name(poses)).missed
    print(f"   {sent} poses sent, {received} received by the PLC")
    if missed:
        print(f"   {missed} overwritten before the PLC's next cycle, because depth 1 keeps only the newest sample")
    return 0 if seen == set(MODES.values()) and received > 0 and received + missed > 0.9 * sent else 1


if __name__ == "__main__":
    sys.exit(main(*sys.argv[1:]))
