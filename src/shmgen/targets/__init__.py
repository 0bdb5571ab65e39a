"""What a target is, and the tuple of all: a room each, which turns a Job into Outputs.

This file holds keys and the names of modules; nothing of a target's code is loaded by it. So
the configuration can take its keys from here without knowing more of a target than its name, and one that is not asked
for costs nothing at start-up.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from dataclasses import field
from importlib import import_module
from typing import TYPE_CHECKING, Any, NamedTuple, Protocol, cast

from shmgen.core.diagnostics import Report
from shmgen.core.fast_dataclass import dataclass
from shmgen.core.model import Action, Layouts, Output, Regions, Service, Topic

if TYPE_CHECKING:
    from shmgen.targets.naming import Names


class Source(NamedTuple):
    """A file of the user's own Structured Text, and the programs in it that a task is to call."""

    text: str
    programs: tuple[str, ...]


@dataclass(frozen=True, slots=True)
class Options:
    """What of shmgen.toml shapes a target's files beside the layouts.

    `distribution` is `robot-shm 1.2.0` or nothing; with `beside`, Python's files bring the runtime with them;
    `task_interval` is in milliseconds; `node` is the bridge's name in the graph; `configuration` is what shmgen.toml
    says, as it was read.
    """

    regions: Regions = field(default_factory=Regions)
    distribution: str = ""
    beside: bool = False
    task_interval: int = 10
    ros_package: str = ""
    node: str = "shmgen_bridge"
    sources: tuple[Source, ...] = ()
    configuration: Mapping[str, Any] = field(default_factory=dict)


@dataclass(frozen=True, slots=True)
class RenderedFile:
    """A file of another target, as it was planned and as it was printed."""

    output: Output
    text: str


@dataclass(frozen=True, slots=True)
class Job:
    """What a target turns into files. `package` is the name that all generated code goes by, `shm_msgs`.

    `printed` are, by their keys, the targets that this one may be `after`.
    """

    layouts: Layouts
    package: str = "shm_msgs"
    topics: tuple[Topic, ...] = ()
    services: tuple[Service, ...] = ()
    actions: tuple[Action, ...] = ()
    options: Options = field(default_factory=Options)
    printed: Mapping[str, tuple[RenderedFile, ...]] = field(default_factory=dict)

    @property
    def uses(self) -> tuple[Topic | Service | Action, ...]:
        """All that shmgen.toml gives a name in the graph."""
        return (*self.topics, *self.services, *self.actions)


class TargetModule(Protocol):
    """The module with a target's code. `NAMES` is None only where it makes no name of the user's."""

    @property
    def NAMES(self) -> Names | None: ...

    def plan(self, job: Job, report: Report) -> Iterator[Output]:
        """The target's files, below a folder of its own. Names that meet are reported before; anything else here."""


@dataclass(frozen=True, slots=True)
class Target:
    """A target: its key in shmgen.toml, and what loads its room.

    `after` are the keys of those whose files this one takes in; they are then planned and printed too, but written
    only where they are asked for themselves. `opt_in` is for what is written only where shmgen.toml asks for it.
    """

    key: str
    room: Callable[[], TargetModule]
    after: tuple[str, ...] = ()
    opt_in: bool = False


def _module(name: str, within: str = "") -> Callable[[], TargetModule]:
    """What loads a module of this package, or an object in it."""

    def load() -> TargetModule:
        module = import_module(f"{__name__}.{name}")
        return cast("TargetModule", getattr(module, within) if within else module)

    return load


TARGETS = (
    Target("python", _module("python.target")),
    Target("st", _module("st.target")),
    Target("plcopen", _module("plcopen.target"), after=("st",)),
    Target("cds_text_sync", _module("plcopen.text_sync"), after=("st",), opt_in=True),
    Target("c", _module("c.target")),
    Target("cpp", _module("cpp.target"), opt_in=True),
    Target("cpp_ros2", _module("cpp_ros.convert", "ROS2"), opt_in=True),
    Target("openplc", _module("openplc.target"), after=("c", "st"), opt_in=True),
    Target("matiec", _module("openplc.matiec"), after=("c", "st"), opt_in=True),
    Target("ros2", _module("ros.package", "ROS2"), opt_in=True),
    Target("ros2_cpp", _module("ros.ros2_cpp"), opt_in=True),
    Target("ros2_control", _module("ros.ros2_control"), opt_in=True),
    Target("cpp_ros1", _module("cpp_ros.convert", "ROS1"), opt_in=True),
    Target("ros1", _module("ros.package", "ROS1"), opt_in=True),
)
"""Each stands behind the one it is `after`."""
KEYS = tuple(target.key for target in TARGETS)
USUAL = tuple(target.key for target in TARGETS if not target.opt_in)
"""Those written where shmgen.toml says nothing of targets."""
