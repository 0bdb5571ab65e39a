"""Makes `ros2 shm` of the `shmgen` command: what the ros2 command line finds as an entry point of `ros2cli.command`."""

from __future__ import annotations

import argparse
import sys


class Shm:
    """Look at shared memory between ROS and PLCs; the same as `shmgen`."""

    NAME = "shm"

    def add_arguments(self, parser: argparse.ArgumentParser, name: str) -> None:
        """All words are shmgen's, its options too: to argparse none looks like one."""
        parser.prefix_chars = "\0"
        parser.add_argument("words", nargs=argparse.REMAINDER)

    def main(self, *, parser: argparse.ArgumentParser, args: argparse.Namespace) -> None:
        """Exits as shmgen does."""
        from shmgen.__main__ import main

        sys.argv = [parser.prog.partition(" ")[0] + " shm", *args.words]
        main()
