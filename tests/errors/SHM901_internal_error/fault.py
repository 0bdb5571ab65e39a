"""Plants a fault in shmgen and runs it: a region's size is None."""

import sys

from shmgen.cli import main
from shmgen.generator import layout

layout.region_size = None  # type: ignore[assignment]
sys.argv = ["shmgen", "generate", "std_msgs/Bool"]
main.main()
