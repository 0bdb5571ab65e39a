"""Long test runs and tools, each a command: `python -m tests.rigs.NAME`."""
