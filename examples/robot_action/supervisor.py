"""Shows the progress of the recipe, read directly from the region, until the last step has ended."""

from __future__ import annotations

import sys
import time

from shm_msgs.robot_msgs.msg import TaskReportSubscriber

STEPS = 5


def main(seconds: float = 90.0) -> int:
    """Print the progress. Return 0 once three tasks were done, one was rejected, and one was cancelled half-way."""
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
                ends = report.done_tasks, report.refused_tasks, report.cancelled_tasks
                print(
                    "   PLC: {} tasks done, {} refused, {} cancelled,".format(*ends), f"{report.length:.1f} m of seam"
                )
                return 0 if ends == (3, 1, 1) and report.feedback_count > STEPS else 1
    print(f"only {step} of {STEPS} steps in {seconds} s", file=sys.stderr)
    return 1


if __name__ == "__main__":
    sys.exit(main())
