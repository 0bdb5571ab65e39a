"""shmgen in a shell where no ROS is sourced, on a machine that has no python3-rosidl."""

import sys

sys.path.insert(0, "bare")

from shmgen.cli.main import main

main()
