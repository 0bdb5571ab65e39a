"""The `shmgen` command, and `python -m shmgen`: loads the rest only if a check is not known to be clean."""

import atexit
import gc
import sys


def main() -> None:
    """Exit 0 clean, 1 diagnostics, 2 wrong usage."""
    if sys.argv[1:2] in (["generate"], ["check"]):
        gc.disable()  # they end before what they leave takes more memory than looking for it takes time
        atexit.register(gc.freeze)  # else Python looks for it when all is done
    if sys.argv[1:2] == ["check"]:
        from shmgen.drift import check_cache

        said = check_cache.load(sys.argv[1:])
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
