"""`python -m shmgen`."""

from shmgen.cli import main

main()
