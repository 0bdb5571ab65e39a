"""Runs shmgen in a shell without a sourced ROS, on a machine without python3-rosidl."""

import sys

sys.path.insert(0, "bare")

from shmgen.cli.main import main

main()
