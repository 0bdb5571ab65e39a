"""The settings of the bridge in shmgen.toml: `[bridge]`, and the keys of each topic that concern the bridge."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, Literal

from shmgen.config.document import Reader


@dataclass(frozen=True, slots=True)
class TransferOptions:
    """The settings with which the bridge transfers a topic.

    `rate` is in Hz, and None means no limit. `stale` is in seconds, and None means that data never becomes stale.
    config/keys.py describes each setting.
    """

    rate: float | None = None
    qos: Literal["auto", "reliable", "best_effort"] = "auto"
    latch: bool = False
    stamp: Literal["now", "keep"] = "now"
    overflow: Literal["reject", "truncate"] = "reject"
    stale: float | None = None
    other_definition: Literal["refuse", "accept"] = "refuse"


@dataclass(frozen=True, slots=True)
class Bridge:
    """The table `[bridge]` of shmgen.toml.

    `diagnostics` is the seconds between two messages on /diagnostics, or 0 for no messages. `domain` is the DDS domain.
    None selects the domain in ROS_DOMAIN_ID.
    """

    backend: str = "auto"
    node: str = "shmgen_bridge"
    diagnostics: float = 1.0
    domain: int | None = None


def transfer_options(read: Reader, section: str, entry: dict[str, Any], values: dict[str, Any]) -> TransferOptions:
    """Return the bridge's settings of one `[[topics]]` entry. Reports SHM502 if the direction excludes a setting."""
    for key, towards in (("stamp", "from_plc"), ("overflow", "to_plc"), ("other_definition", "to_plc")):
        if key in entry and values["direction"] != towards:
            read.wrong(section, key, f'{key} is valid only with direction = "{towards}"')
    return TransferOptions(**{name: values[name] for name in TransferOptions.__match_args__})
