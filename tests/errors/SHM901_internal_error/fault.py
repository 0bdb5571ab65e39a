"""Plants a fault in shmgen and runs it: the function that checks sizes is None."""

import sys

from shmgen.cli import main
from shmgen.generator import layout

layout.check_size = None  # type: ignore[assignment]
sys.argv = ["shmgen", "generate", "std_msgs/Bool"]
main.main()
