"""The `shmgen` command, and `python -m shmgen`: loads the rest only for what is not remembered."""

import atexit
import gc
import sys

from shmgen.drift import check_cache


def main() -> None:
    """Exit 0 clean, 1 diagnostics, 2 wrong usage."""
    asked = check_cache.fixed() or sys.argv[1:]
    if asked[:1] in (["generate"], ["check"]):
        gc.disable()  # they end before what they leave takes more memory than looking for it takes time
        atexit.register(gc.freeze)  # else Python looks for it when all is done
    said = check_cache.load(asked)
    if said is not None:
        try:
            print(said, end="", flush=True)
            return
        except OSError:
            pass  # the disk is full or nobody reads: the rest tells it as every command does
    from shmgen.cli.main import main as run

    run()


if __name__ == "__main__":
    main()
