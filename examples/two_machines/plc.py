"""Simulates the PLC of one machine: publishes its state, serves a call and makes calls.

    python plc.py a b RATE

Prints its statistics for each line on standard input. The line `new` also starts new lists of times.
"""

from __future__ import annotations

import json
import sys
import threading
import time

from shm_msgs.geometry_msgs.msg import Point, PointPublisher, PointSubscriber
from shm_msgs.std_srvs.srv import Trigger_Request, Trigger_Response, TriggerClient, TriggerServer

from shmgen.runtime import ShmError

PAUSE = 0.02
"""Seconds between two calls."""
STALE = 0.5
"""Seconds until a topic is stale: tTimeout of the PLC's function block."""
DEPTH = 255


class Plc:
    """Simulates a PLC, with one thread for each task that a PLC program would do in its cycle."""

    def __init__(self, me: str, other: str, rate: float) -> None:
        self.me, self.other, self.rate = me, other, rate
        self.sent = self.last = self.gaps = 0
        self.late: list[float] = []
        self.calls: list[float] = []
        self.failed = 0
        self.stale_since = 0.0
        for work in (self.publish_state, self.read_state, self.serve, self.call):
            threading.Thread(target=work, daemon=True).start()

    def publish_state(self) -> None:
        with PointPublisher(f"/{self.me}/state", depth=DEPTH) as publisher:
            begun = time.monotonic()
            while True:
                self.sent += 1
                publisher.publish(Point(x=self.sent, y=time.monotonic()))
                time.sleep(max(0.0, begun + self.sent / self.rate - time.monotonic()))

    def read_state(self) -> None:
        with PointSubscriber(f"/{self.other}/state", depth=DEPTH) as self.reader:
            while True:
                self.reader.ready(0.01)
                for state in self.reader.read_all():
                    self.gaps += max(0, int(state.x) - self.last - 1) if self.last else 0
                    self.last = int(state.x)
                    self.late.append(time.monotonic() - state.y)
                stale = self.reader.is_stale(STALE)
                self.stale_since = (self.stale_since or time.monotonic()) if stale else 0.0

    def serve(self) -> None:
        with TriggerServer(f"/{self.me}/stop") as server:
            while True:
                server.serve(lambda request: Trigger_Response(success=True), timeout=1)

    def call(self) -> None:
        with TriggerClient(f"/{self.other}/stop") as client:
            while True:
                begun = time.monotonic()
                try:
                    client.call(Trigger_Request(), timeout=2)
                    self.calls.append(time.monotonic() - begun)
                except ShmError:
                    self.failed += 1
                time.sleep(PAUSE)

    def statistics(self, new: bool) -> dict[str, object]:
        """Return the statistics. `gaps` counts missing sample numbers, and `missed` is the counter of the subscriber.

        If `new` is true, start new lists of times.
        """
        counts = {"late": self.late, "calls": self.calls, "failed": self.failed, "stale_since": self.stale_since}
        counts |= {"gaps": self.gaps, "missed": self.reader.missed, "last": self.last}
        if new:
            self.late, self.calls = [], []
        return counts


def main(me: str, other: str, rate: str) -> None:
    """Run the simulated PLC until standard input ends."""
    plc = Plc(me, other, float(rate))
    print("ready", flush=True)
    for line in sys.stdin:
        print(json.dumps(plc.statistics(line == "new\n")), flush=True)


if __name__ == "__main__":
    main(*sys.argv[1:])
