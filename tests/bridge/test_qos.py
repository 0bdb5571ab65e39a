"""Test a topic whose ROS publishers or subscribers have another QoS."""

from __future__ import annotations

from typing import Any

import pytest

from shmgen.bridge.backend import Wire
from shmgen.bridge.common import qos
from shmgen.bridge.common.qos import AdoptingSubscription, Qos

RELIABLE, BEST_EFFORT, LATCHED = Qos(True, False), Qos(False, False), Qos(True, True)


class Endpoints:
    """The QoS of the created and of the removed endpoints of a subscription."""

    def __init__(self) -> None:
        self.created: list[Qos] = []
        self.removed: list[Qos] = []

    def create(self, policies: Qos) -> Any:
        self.created.append(policies)
        return object(), policies, lambda: self.removed.append(policies)


@pytest.mark.parametrize("key", ["auto", "reliable", "best_effort"])
def test_only_auto_adopts_the_qos_of_publishers(key: Any) -> None:
    ends, offered = Endpoints(), [RELIABLE]
    subscription = AdoptingSubscription(Wire("/a", (), qos=key), ends.create, lambda: offered)
    assert not subscription.qos_problem()
    offered.append(BEST_EFFORT)
    reason = subscription.qos_problem()
    assert ends.created == {"auto": [RELIABLE, BEST_EFFORT], "reliable": [RELIABLE], "best_effort": [BEST_EFFORT]}[key]
    assert ends.removed == ends.created[:-1]
    assert ('Set qos = "best_effort" in shmgen.toml' in reason) == (key == "reliable")
    offered.pop()
    assert not subscription.qos_problem()


@pytest.mark.parametrize(
    ("own", "peer", "publishes", "line"),
    [
        (BEST_EFFORT, RELIABLE, True, 'qos = "reliable"'),
        (RELIABLE, LATCHED, True, "latch = true"),
        (LATCHED, RELIABLE, False, "latch = false"),
        (LATCHED, RELIABLE, True, ""),
        (RELIABLE, BEST_EFFORT, True, ""),
        (BEST_EFFORT, LATCHED, False, ""),
    ],
)
def test_qos_problem_names_both_sides_and_the_setting(own: Qos, peer: Qos, publishes: bool, line: str) -> None:
    reason = qos.problem(own, [peer], publishes)
    assert bool(reason) == bool(line)
    assert not line or (line in reason and str(own) in reason and str(peer) in reason)
