"""What a target is, and the tuple of all: a room each, which turns a Job into Outputs.

This file holds keys, and functions that load a room when it is needed; nothing of a target's code is loaded by it. So
the configuration can take its keys from here without knowing more of a target than its name, and one that is not asked
for costs nothing at start-up.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from dataclasses import field
from typing import TYPE_CHECKING, Any, Protocol

from shmgen.core.diagnostics import Report
from shmgen.core.fast_dataclass import dataclass
from shmgen.core.model import Action, Layouts, Output, Regions, Service, Topic

if TYPE_CHECKING:
    from shmgen.targets.naming import Names


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

    `after` is the key of another target whose files this one takes in; that one is then planned and printed too, but
    written only where it is asked for itself. `opt_in` is for what is written only where shmgen.toml asks for it.
    """

    key: str
    room: Callable[[], TargetModule]
    after: str = ""
    opt_in: bool = False


def _python() -> TargetModule:
    from shmgen.targets.python import target

    return target


def _st() -> TargetModule:
    from shmgen.targets.st import target

    return target


def _plcopen() -> TargetModule:
    from shmgen.targets.plcopen import target

    return target


def _c() -> TargetModule:
    from shmgen.targets.c import target

    return target


def _cpp() -> TargetModule:
    from shmgen.targets.cpp import target

    return target


def _cpp_ros1() -> TargetModule:
    from shmgen.targets.cpp_ros import ros1

    return ros1


def _cpp_ros2() -> TargetModule:
    from shmgen.targets.cpp_ros import ros2

    return ros2


def _matiec() -> TargetModule:
    from shmgen.targets.openplc import matiec as target

    return target


def _openplc() -> TargetModule:
    from shmgen.targets.openplc import target

    return target


def _ros1() -> TargetModule:
    from shmgen.targets.ros import ros1

    return ros1


def _ros2() -> TargetModule:
    from shmgen.targets.ros import ros2

    return ros2


TARGETS = (
    Target("python", _python),
    Target("st", _st),
    Target("plcopen", _plcopen, after="st"),
    Target("c", _c),
    Target("cpp", _cpp, opt_in=True),
    Target("cpp_ros1", _cpp_ros1, opt_in=True),
    Target("cpp_ros2", _cpp_ros2, opt_in=True),
    Target("openplc", _openplc, after="c", opt_in=True),
    Target("matiec", _matiec, after="c", opt_in=True),
    Target("ros1", _ros1, opt_in=True),
    Target("ros2", _ros2, opt_in=True),
)
"""Each stands behind the one it is `after`."""
KEYS = tuple(target.key for target in TARGETS)
USUAL = tuple(target.key for target in TARGETS if not target.opt_in)
"""Those written where shmgen.toml says nothing of targets."""
