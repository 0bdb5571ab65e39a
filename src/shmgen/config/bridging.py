"""What shmgen.toml says to the bridge, in `[bridge]` and for each topic."""

from __future__ import annotations

from typing import Any, Literal

from shmgen.config.document import Reader
from shmgen.core.fast_dataclass import dataclass


@dataclass(frozen=True, slots=True)
class Carrying:
    """How the bridge carries a topic. `rate` is in Hz, None = as it comes; `stale` in seconds, None = never."""

    rate: float | None = None
    qos: Literal["reliable", "best_effort"] = "reliable"
    latch: bool = False
    stamp: Literal["now", "keep"] = "now"
    overflow: Literal["reject", "truncate"] = "reject"
    stale: float | None = None
    other_definition: Literal["refuse", "accept"] = "refuse"


@dataclass(frozen=True, slots=True)
class Bridge:
    """`[bridge]`. `diagnostics` is in seconds, 0 = none; `domain` is DDS's, None = ROS_DOMAIN_ID."""

    backend: str = "auto"
    node: str = "shmgen_bridge"
    diagnostics: float = 1.0
    domain: int | None = None


def carrying(read: Reader, section: str, entry: dict[str, Any], values: dict[str, Any]) -> Carrying:
    """Of one `[[topics]]` entry. Reports SHM502."""
    for key, towards in (("stamp", "from_plc"), ("overflow", "to_plc"), ("other_definition", "to_plc")):
        if key in entry and values["direction"] != towards:
            read.wrong(section, key, f'{key} is of topics with direction = "{towards}"')
    return Carrying(**{name: values[name] for name in Carrying.__match_args__})
