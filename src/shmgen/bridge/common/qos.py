"""Compares the QoS of a topic with the QoS of its peers, adopts a compatible QoS, and reports mismatches."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from typing import Any, NamedTuple

from shmgen.bridge.backend import Wire


class Qos(NamedTuple):
    """The QoS policies of ROS 2 that can prevent a publisher and a subscriber from matching."""

    reliable: bool
    latched: bool

    def __str__(self) -> str:
        durability = "transient local" if self.latched else "volatile"
        return f"{'reliable' if self.reliable else 'best effort'} and {durability}"


def ours(wire: Wire) -> Qos:
    """Return the QoS that shmgen.toml sets for the topic `wire`. The default is reliable."""
    return Qos(wire.qos != "best_effort", wire.latch)


class AdoptingSubscription:
    """A subscription that is removed and created again to adopt the QoS of a publisher."""

    def __init__(
        self,
        wire: Wire,
        create: Callable[[Qos], tuple[Any, Qos, Callable[[], None]]],
        offered: Callable[[], list[Qos]],
    ) -> None:
        """Create the subscription. `offered()` returns the QoS of all publishers of the topic.

        `create` receives the QoS to request, and returns the subscription, its QoS and a function that removes it.
        """
        self._is_open = wire.qos == "auto"
        self._create, self._offered = create, offered
        self.end, self._own, self._undo = create(ours(wire))

    def undo(self) -> None:
        """Remove the subscription from ROS."""
        self._undo()

    def qos_problem(self) -> str:
        """Return why a publisher does not match, or `""`. First adopt best effort if a publisher offers only that."""
        offered = self._offered()
        if self._is_open and self._own.reliable and not all(publisher.reliable for publisher in offered):
            self._undo()
            self.end, self._own, self._undo = self._create(self._own._replace(reliable=False))
        return problem(self._own, offered, publishes=False)


def problem(own: Qos, peers: Iterable[Qos], publishes: bool) -> str:
    """Return a text: why no message passes between the bridge and a peer, and the line to set in shmgen.toml.

    Return `""` if all peers match. `own` is the bridge's QoS. If `publishes` is True, the bridge publishes and the
    peers subscribe, or else the other way round.
    """
    for peer in peers:
        offered, requested = (own, peer) if publishes else (peer, own)
        if requested.reliable and not offered.reliable:
            line = f'qos = "{"reliable" if publishes else "best_effort"}"'
        elif requested.latched and not offered.latched:
            line = f"latch = {'true' if publishes else 'false'}"
        else:
            continue
        who = "subscriber" if publishes else "publisher"
        return f"a {who} is {peer}, and this topic {own}: no messages pass between the two. Set {line} in shmgen.toml"
    return ""
