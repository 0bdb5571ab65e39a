"""Shows the progress of the recipe, read directly from the region, until the last step has ended."""

from __future__ import annotations

import sys
import time

from shm_msgs.robot_msgs.msg import TaskReportSubscriber

STEPS = 4


def main(seconds: float = 90.0) -> int:
    """Print the progress. Return 0 once three tasks were done and one was rejected."""
    deadline = time.monotonic() + seconds
    step = 0
    with TaskReportSubscriber("/robot/report") as reports:
        while time.monotonic() < deadline:
            report = reports.wait(timeout=1.0)
            if report is None or report.step_number == step:
                continue
            step = report.step_number
            print(f"   PLC: step {step}: {report.message}", flush=True)
            if step == STEPS:
                done, refused = report.done_tasks, report.refused_tasks
                print(f"   PLC: {done} tasks done, {refused} refused, {report.seconds:.1f} s of motion")
                return 0 if (done, refused) == (3, 1) else 1
    print(f"only {step} of {STEPS} steps in {seconds} s", file=sys.stderr)
    return 1


if __name__ == "__main__":
    sys.exit(main())
