"""What the bridge does with each topic, service and action alike, whichever way it goes."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol

from shmgen.bridge.backend import Backend
from shmgen.bridge.counters import Counters


@dataclass(frozen=True, slots=True)
class About:
    """What it is called in ROS, which way it goes, its type, and its region."""

    name: str
    way: str
    type: str
    region: str


class Side(Protocol):
    """A topic, a service or an action. Its constructor opens the regions, and raises what a Publisher raises."""

    about: About
    counters: Counters

    def join(self, backend: Backend) -> None:
        """Begins to carry. Raises ValueError for a type that this ROS has otherwise or not at all."""

    def tick(self) -> None:
        """Is called ten times a second."""

    def silence(self) -> str:
        """Why the peer is taken for gone, or nothing."""

    @property
    def is_open(self) -> bool:
        """Whether there is a region now."""

    @property
    def lock_misses(self) -> int:
        """How often a region's lock was not free in time."""

    def leave(self) -> None:
        """Ends what is under way while its peers can still be told; `stopping` is set by then, and for what follows."""

    def close(self) -> None:
        """Lets go of the regions."""
