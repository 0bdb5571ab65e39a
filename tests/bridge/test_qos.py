"""What a topic does with publishers and subscribers of another QoS."""

from __future__ import annotations

from typing import Any

import pytest

from shmgen.bridge.backend import Wire
from shmgen.bridge.common import qos
from shmgen.bridge.common.qos import AdoptingSubscription, Qos

RELIABLE, BEST_EFFORT, LATCHED = Qos(True, False), Qos(False, False), Qos(True, True)


class Ends:
    """Ends of a subscription that were created, and those that were taken back."""

    def __init__(self) -> None:
        self.created: list[Qos] = []
        self.undone: list[Qos] = []

    def create(self, policies: Qos) -> Any:
        self.created.append(policies)
        return object(), policies, lambda: self.undone.append(policies)


@pytest.mark.parametrize("key", ["auto", "reliable", "best_effort"])
def test_only_auto_adopts_what_publishers_offer(key: Any) -> None:
    ends, offered = Ends(), [RELIABLE]
    subscription = AdoptingSubscription(Wire("/a", (), qos=key), ends.create, lambda: offered)
    assert not subscription.qos_problem()
    offered.append(BEST_EFFORT)
    why = subscription.qos_problem()
    assert ends.created == {"auto": [RELIABLE, BEST_EFFORT], "reliable": [RELIABLE], "best_effort": [BEST_EFFORT]}[key]
    assert ends.undone == ends.created[:-1]
    assert ('Set qos = "best_effort" in shmgen.toml' in why) == (key == "reliable")
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
def test_a_problem_names_both_sides_and_the_line(own: Qos, peer: Qos, publishes: bool, line: str) -> None:
    why = qos.problem(own, [peer], publishes)
    assert bool(why) == bool(line)
    assert not line or (line in why and str(own) in why and str(peer) in why)
