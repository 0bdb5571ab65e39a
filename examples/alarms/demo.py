"""Shows a PLC's alarm list on /diagnostics: raised, cleared, acknowledged, kept while the bridge is away."""

from __future__ import annotations

import os
import sys
import time
from pathlib import Path

HERE = Path(__file__).parent
sys.path.insert(0, str(HERE.parent))

from stage import LOOPBACK, cell  # noqa: E402 the module is in examples/

ACKNOWLEDGED, UNACKNOWLEDGED, CLEARED = "acknowledged", "not acknowledged", "cleared, not acknowledged"


def main() -> int:
    """Run the demo and return 0. Raises SystemExit if an expected state of the alarms does not arrive."""
    with cell(HERE, "blark", "cyclonedds") as here:
        os.environ.setdefault("CYCLONEDDS_URI", LOOPBACK)
        here.generate()
        from supervisor import Supervisor

        here.start_plc("PRG_Plant", "PRG_Alarms")
        bridge = here.start_bridge("dds")
        ros = Supervisor()

        def step(what: str, **expected: str) -> None:
            seconds = ros.until({f"press: {name}": message for name, message in expected.items()})
            values = [f"{alarm.associated_values_[0]:g} degC" for alarm in ros.alarms]
            print(f"   {what}: {expected or 'no alarm'} {' '.join(values)} after {seconds:.3f} s", flush=True)

        step("too hot, before a ROS node started", temperature=UNACKNOWLEDGED)
        ros.acknowledge(1)
        step("acknowledged", temperature=ACKNOWLEDGED)
        step("cooled down")
        bridge.kill()
        bridge.wait()
        print("   the bridge is killed; the door opens and closes", flush=True)
        time.sleep(4.5)
        here.start_bridge("dds")
        step("the bridge is back", door=CLEARED)
        ros.acknowledge(2)
        step("acknowledged")
    return 0


if __name__ == "__main__":
    sys.exit(main())
