"""List all targets. A target turns a Job into the files of one output language.

This file names the module of each target but does not import the modules. The configuration can therefore list the keys
cheaply, and an unselected target adds nothing to the start-up time.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from importlib import import_module
from typing import TYPE_CHECKING, Any, NamedTuple, Protocol, cast

from shmgen.core.diagnostics import Report
from shmgen.core.model import Call, Layouts, Output, Regions, Topic

if TYPE_CHECKING:
    from shmgen.targets.naming import Names


class Source(NamedTuple):
    """A file of the user's own Structured Text, and the programs in the file that a task must call."""

    text: str
    programs: tuple[str, ...]


class Options(NamedTuple):
    """The settings from shmgen.toml that change a target's files but not the layouts of messages.

    * `distribution`: the name and version of the Python package, such as `robot-shm 1.2.0`, or `""`.
    * `beside`: True if the Python files include a copy of shmgen.runtime.
    * `task_interval`: the milliseconds between two calls of the generated program PRG_Ros.
    * `node`: the bridge's node name in the ROS graph.
    * `configuration`: the parsed content of shmgen.toml.
    """

    regions: Regions = Regions()
    distribution: str = ""
    beside: bool = False
    task_interval: int = 10
    ros_package: str = ""
    node: str = "shmgen_bridge"
    sources: tuple[Source, ...] = ()
    configuration: Mapping[str, Any] = {}


class Text(NamedTuple):
    """The template data for a file whose `text` the template inserts unchanged."""

    text: str


class RenderedFile(NamedTuple):
    """A rendered file of a target: `output` is its plan (path, template and data), and `text` is its content."""

    output: Output
    text: str


class Job(NamedTuple):
    """The input of a target: the layouts of all messages, and the settings of shmgen.toml.

    `package` is the name of all generated code, such as `shm_msgs`. `rendered` maps the keys of other targets to their
    rendered files, at least of all targets in `Target.after`.
    """

    layouts: Layouts
    package: str = "shm_msgs"
    topics: tuple[Topic, ...] = ()
    services: tuple[Call, ...] = ()
    actions: tuple[Call, ...] = ()
    options: Options = Options()
    rendered: Mapping[str, tuple[RenderedFile, ...]] = {}

    @property
    def uses(self) -> tuple[Topic | Call, ...]:
        """All topics, services and actions of shmgen.toml."""
        return (*self.topics, *self.services, *self.actions)


class TargetModule(Protocol):
    """The interface of a module that implements a target: its naming rules and its `plan` function.

    `NAMES` is None if the target derives no names from the user's names.
    """

    @property
    def NAMES(self) -> Names | None: ...

    def plan(self, job: Job, report: Report) -> Iterator[Output]:
        """Yield the target's files, each path below the target's own folder.

        Errors go to `report`, except colliding names, which the pipeline reports before it calls this method.
        """


class Target(NamedTuple):
    """A target: its key in shmgen.toml, and the function that loads its module.

    * `after` lists the targets that must be rendered first, because this target includes parts of their files. If the
      user did not request a target in `after`, its files are rendered but not written.
    * `opt_in` targets are written only if `targets` in shmgen.toml contains their keys.
    """

    key: str
    load: Callable[[], TargetModule]
    after: tuple[str, ...] = ()
    opt_in: bool = False


def _module(name: str, within: str = "") -> Callable[[], TargetModule]:
    """Return a function that imports the submodule `name` of this package and returns the submodule.

    If `within` is given, the function returns the object of this name in the submodule instead.
    """

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
"""All targets. Each target follows the targets in its `after`."""
KEYS = tuple(target.key for target in TARGETS)
USUAL = tuple(target.key for target in TARGETS if not target.opt_in)
"""The keys of the targets that are written if shmgen.toml names no targets."""
