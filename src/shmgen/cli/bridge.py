"""The command bridge: starts one, and prints what it says."""

from __future__ import annotations

import sys
from dataclasses import replace
from pathlib import Path

import click

from shmgen.cli import common, options
from shmgen.config import Config
from shmgen.config.keys import BACKENDS


@click.command(context_settings={"ignore_unknown_options": True})
@click.option("--backend", type=click.Choice(BACKENDS), help="Overrides shmgen.toml.")
@click.argument("ros_arguments", nargs=-1, type=click.UNPROCESSED, metavar="[ROS_ARGUMENT]...")
@options.where
def bridge(
    backend: str | None, ros_arguments: tuple[str, ...], config_file: Path | None, include: tuple[Path, ...]
) -> None:
    """Carry topics, services and actions between ROS and shared memory.

    Runs what shmgen.toml lists, until Ctrl-C or SIGTERM. Backends: ros2 (rclpy), dds and zenoh (a ROS 2 graph
    through cyclonedds or eclipse-zenoh, without ROS) and ros1 (rospy); auto selects the ROS whose setup was sourced,
    or else one that is installed.
    Prints its counters on SIGUSR1 and at exit, and reads shmgen.toml again on SIGHUP.
    """
    from shmgen.bridge.backend import BackendMissing
    from shmgen.bridge.run import run
    from shmgen.runtime import ShmError

    def load() -> Config:
        config = options.load(config_file, include)
        return replace(config, bridge=replace(config.bridge, backend=backend)) if backend else config

    config = load()
    if not (config.topics or config.services or config.actions):
        raise click.UsageError(
            "shmgen.toml lists no [[topics]], [[services]] or [[actions]]: there is nothing to carry."
        )
    try:
        run(config, ros_arguments, _say, _tell, load)
    except (BackendMissing, ValueError) as error:  # which begin with what they are about
        common.fail(str(error))
    except (ShmError, OSError) as error:
        common.fail(f"{config.bridge.node}: {error}")


COMMANDS = (bridge,)


def _say(text: str) -> None:
    click.echo(text)
    sys.stdout.flush()


def _tell(text: str) -> None:
    common.note(text.replace("\n", "\n  "))  # peers had a word in it, and begin no line of the log
