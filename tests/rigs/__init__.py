"""Long runs and tools of the tests, each a command: `python -m tests.rigs.NAME`."""
