"""The command bridge: starts a bridge and prints its messages."""

from __future__ import annotations

from dataclasses import replace

import click

from shmgen.cli import common, options
from shmgen.config import Config
from shmgen.config.keys import BACKENDS
from shmgen.core.diagnostics import Diagnostic, Rejected, Span


@click.command(context_settings={"ignore_unknown_options": True})
@click.option(
    "--backend",
    type=options.Word(BACKENDS),
    metavar="BACKEND",
    help="Use this backend instead of the one in shmgen.toml.",
)
@click.argument("ros_arguments", nargs=-1, type=click.UNPROCESSED, metavar="[ROS_ARGUMENT]...")
@options.source_options
def bridge(backend: str | None, ros_arguments: tuple[str, ...], source: options.Source) -> None:
    """Connect ROS topics, services and actions to shared memory.

    The bridge carries the topics, services and actions of shmgen.toml until Ctrl-C or SIGTERM. The backends are ros2
    (rclpy), ros1 (rospy), dds and zenoh. The backends dds and zenoh connect to ROS 2 nodes through the Python packages
    cyclonedds or eclipse-zenoh, without an installed ROS. With the backend auto, the bridge uses the ROS whose setup
    was sourced. If no setup was sourced, the bridge uses the first installed backend of ros2, dds, zenoh and ros1.
    ROS_ARGUMENT is an argument of a ROS node, such as `--ros-args -r __node:=cell`. On SIGUSR1 and at exit, the bridge
    prints its counters. On SIGHUP, the bridge reads shmgen.toml again.
    """
    from shmgen.bridge.backend import BackendMissing
    from shmgen.bridge.common import watchdog
    from shmgen.bridge.run import NothingListed, require_entries, run
    from shmgen.runtime import ShmError

    def load() -> Config:
        config = source.load()
        return replace(config, bridge=config.bridge._replace(backend=backend)) if backend else config

    config = load()
    file = source.file_used()
    place = str(source.file or (file.name if file else "shmgen.toml"))
    try:
        require_entries(config)
        run(config, ros_arguments, click.echo, _tell, load)
    except NothingListed as error:
        hint = 'add an entry: [[topics]] with topic = "/pose", type = "geometry_msgs/Pose", direction = "to_plc"'
        raise Rejected([Diagnostic("SHM504", str(error), Span(place), hint=hint)]) from None
    except (BackendMissing, ShmError, OSError, ValueError) as error:
        hint = "correct this argument, setting or variable, and start the bridge again"
        raise Rejected([common.diagnostic(error, place, hint)]) from error
    watchdog.exit_at_once()


COMMANDS = (bridge,)


def _tell(text: str) -> None:
    common.note(text.replace("\n", "\n  "))  # indent later lines: text from peers must not start a log line
