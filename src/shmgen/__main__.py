"""The entry point of `shmgen` and `python -m shmgen`.

Prints a cached answer at once, and imports the rest of shmgen only if the cache has none.
"""

import atexit
import gc
import sys

from shmgen.cli import check_cache


def main() -> None:
    """Run the command, and exit with status 0 without errors, 1 after diagnostics, or 2 for wrong usage."""
    cache_key = check_cache.static_key() or sys.argv[1:]
    if cache_key[:1] in (["generate"], ["check"]):
        gc.disable()  # both commands are so short that collecting garbage costs more than it frees
        atexit.register(gc.freeze)  # otherwise Python collects garbage at exit
    output = check_cache.load(cache_key)
    if output is not None:
        try:
            print(output, end="", flush=True)
            return
        except OSError:
            pass  # the disk is full or the reader has closed the pipe: main() reports it
    from shmgen.cli.main import main as run

    run()


if __name__ == "__main__":
    main()
