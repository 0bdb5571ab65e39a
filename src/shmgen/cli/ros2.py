"""Provides `ros2 shm`: the `shmgen` command as an extension of ros2 (entry point `ros2cli.command`)."""

from __future__ import annotations

import argparse
import sys


class Shm:
    """Look at shared memory between ROS and PLCs, with the commands of `shmgen`."""

    NAME = "shm"

    def add_arguments(self, parser: argparse.ArgumentParser, name: str) -> None:
        """Pass all words to shmgen. A NUL as prefix character keeps argparse from parsing options."""
        parser.prefix_chars = "\0"
        parser.add_argument("words", nargs=argparse.REMAINDER)

    def main(self, *, parser: argparse.ArgumentParser, args: argparse.Namespace) -> None:
        """Run shmgen and exit with its exit code."""
        from shmgen.__main__ import main

        sys.argv = [parser.prog.partition(" ")[0] + " shm", *args.words]
        main()
