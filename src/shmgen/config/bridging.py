"""Turns what shmgen.toml says to the bridge, in `[bridge]` and for each topic, into data."""

from __future__ import annotations

from typing import Any, Literal, NamedTuple

from shmgen.config.document import Reader
from shmgen.core.fast_dataclass import dataclass

CARRYING = ("rate", "qos", "latch", "stamp", "overflow", "stale", "other_definition")
"""Keys of `[[topics]]` that only the bridge reads; none of them changes a byte of a region."""
MAX_RATE = 10_000.0
MAX_SECONDS = 86_400.0
MAX_DOMAIN = 232
"""The highest DDS domain whose ports are below 65536 (RTPS, 9.6.2.3)."""


class Backend(NamedTuple):
    """A backend of the bridge, the package `shmgen.bridge.<key>`.

    `imports` is what it is made of, `install` what to type where that is missing, and `ros_version` what ROS_VERSION
    is where the setup of its ROS was sourced.
    """

    key: str
    imports: str
    install: str
    ros_version: str = ""


BACKENDS = (
    Backend("ros2", "rclpy", "`source /opt/ros/jazzy/setup.bash`, in the Python that ROS was built for", "2"),
    Backend("dds", "cyclonedds", "`pip install cyclonedds`"),
    Backend("zenoh", "zenoh", "`pip install eclipse-zenoh`"),
    Backend("ros1", "rospy", "`apt-get install python3-rospy`, or `source /opt/ros/noetic/setup.bash`", "1"),
)
"""In the order in which `auto` looks for them."""
BACKEND_KEYS = ("auto", *(backend.key for backend in BACKENDS))


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


def carrying(read: Reader, section: str, entry: dict[str, Any], direction: str) -> Carrying:
    """Of one `[[topics]]` entry. Reports SHM502."""
    for key, towards in (("stamp", "from_plc"), ("overflow", "to_plc"), ("other_definition", "to_plc")):
        if key in entry and direction != towards:
            read.wrong(section, key, f'{key} is of topics with direction = "{towards}"')
    return Carrying(
        rate=read.real(section, "rate", entry, None, 0.001, MAX_RATE, "Hz"),
        qos=read.choice(section, "qos", entry, ("reliable", "best_effort"), "reliable"),  # type: ignore[arg-type]
        latch=read.flag(section, "latch", entry, False),
        stamp=read.choice(section, "stamp", entry, ("now", "keep"), "now"),  # type: ignore[arg-type]
        overflow=read.choice(section, "overflow", entry, ("reject", "truncate"), "reject"),  # type: ignore[arg-type]
        stale=read.real(section, "stale", entry, None, 0.01, MAX_SECONDS, "seconds"),
        other_definition=read.choice(section, "other_definition", entry, ("refuse", "accept"), "refuse"),  # type: ignore[arg-type]
    )


def bridge(read: Reader, table: dict[str, Any]) -> Bridge:
    """Of `[bridge]`. Reports SHM501, SHM502."""
    read.keys("bridge", table, ("backend", "node", "diagnostics", "domain"))
    usual = Bridge()
    node = table.get("node", usual.node)
    if not isinstance(node, str) or not node.isascii() or not node.isidentifier():
        read.wrong("bridge", "node", f"node is a name of letters, digits and _, no digit first, not {node!r}")
    domain = table.get("domain")
    if domain is not None and (type(domain) is not int or not 0 <= domain <= MAX_DOMAIN):
        read.wrong("bridge", "domain", f"domain is a whole number from 0 to {MAX_DOMAIN}, not {domain!r}")
    seconds = read.real("bridge", "diagnostics", table, usual.diagnostics, 0, MAX_SECONDS, "seconds")
    return Bridge(
        backend=read.choice("bridge", "backend", table, BACKEND_KEYS, "auto"),
        node=str(node),
        diagnostics=usual.diagnostics if seconds is None else seconds,
        domain=domain,
    )
