"""Parses many random definitions that nobody would write: python -m tests.rigs.fuzz_many 1000000.

Unlike `make fuzz`, the inputs are not guided by coverage, so this is faster, and it uses all processors. Two of three
definitions are damaged real definitions, and one is generated from a grammar. Every 200th goes through all stages. Each
seed gives a thousand definitions, so that a failure can be repeated. Inputs that fail are kept in .fuzz/.
"""

from __future__ import annotations

import argparse
import os
import sys
import tempfile
import time
import traceback
from functools import partial
from multiprocessing import get_context
from pathlib import Path
from random import Random

from tests.support import REPOSITORY, SHARED, foreign
from tests.support.definitions import Fuzzed, from_files, from_grammar, generated, read
from tests.support.guard import within

AT_ONCE = 1000
"""Definitions that one seed makes."""
SECONDS = 10
"""Of CPU for one definition; it takes some milliseconds."""
TARGETS = ("python", "st", "plcopen", "c")
FILES = sorted((SHARED / "corpus").glob("*/*/*/*.[msa]*"))


def definitions(seed: int) -> list[Fuzzed]:
    dice = Random(seed)
    return [from_files(FILES, dice) if dice.randrange(3) else from_grammar(dice) for _ in range(AT_ONCE)]


def run_foreign(kind: str, seed: int) -> tuple[int, int, list[str]]:
    """Parse the damaged foreign files of a seed. Return the same numbers and texts as run()."""
    readable, failed, dice = 0, [], Random(seed)
    found = foreign.seeds(kind)
    with tempfile.TemporaryDirectory(prefix="shmgen-fuzz") as name:
        for number in range(AT_ONCE):
            data = foreign.damaged(kind, dice.choice(found), dice)
            try:
                with within(SECONDS):
                    readable += foreign.read(kind, data, Path(name))
            except Exception:
                kept = REPOSITORY / ".fuzz" / f"{seed}-{number}.{kind}"
                kept.parent.mkdir(exist_ok=True)
                kept.write_bytes(data)
                failed.append(f"{kept}:\n{traceback.format_exc()}")
    return readable, 0, failed


def run(seed: int) -> tuple[int, int, list[str]]:
    """Parse the definitions of a seed.

    Return how many were valid, how many went through all stages, and a text for each failure.
    """
    readable, whole, failed = 0, 0, []
    with tempfile.TemporaryDirectory(prefix="shmgen-fuzz") as name:
        folder = Path(name)
        for number, fuzzed in enumerate(definitions(seed)):
            try:
                with within(SECONDS):
                    if number % 200 == 0:
                        whole += generated(fuzzed, folder, TARGETS) is not None
                    else:
                        readable += read(fuzzed, folder) is not None
            except Exception:
                kept = REPOSITORY / ".fuzz" / f"{seed}-{number}.{fuzzed.kind}"
                kept.parent.mkdir(exist_ok=True)
                kept.write_bytes(fuzzed.data)
                failed.append(f"{kept} ({fuzzed.source}):\n{traceback.format_exc()}")
    return readable, whole, failed


def main() -> None:
    """Parse the requested number of definitions. The exit code is 1 if one failed."""
    parser = argparse.ArgumentParser(description="Reads definitions nobody would write.")
    parser.add_argument("number", type=int)
    parser.add_argument("--first", type=int, default=1, help="seed to begin with")
    parser.add_argument("--seconds", type=float, default=float("inf"), help="after which no more are begun")
    parser.add_argument("--of", choices=("definitions", *foreign.KINDS), default="definitions")
    parser.add_argument("--processes", type=int, default=os.cpu_count())
    given = parser.parse_args()
    count = readable = whole = faults = 0
    begin = time.monotonic()
    work = run if given.of == "definitions" else partial(run_foreign, given.of)
    seeds = range(given.first, given.first + -(-given.number // AT_ONCE))
    with get_context("fork").Pool(given.processes) as pool:
        for read_here, whole_here, failed in pool.imap_unordered(work, seeds):
            count, readable, whole = count + AT_ONCE, readable + read_here, whole + whole_here
            faults += len(failed)
            print(*failed, sep="\n", end="", flush=True)
            if count % (50 * AT_ONCE) == 0 or time.monotonic() - begin > given.seconds:
                print(f"{count:,} after {time.monotonic() - begin:.0f} s, {faults} failed", flush=True)
            if time.monotonic() - begin > given.seconds:
                break
    print(f"{count:,} {given.of}, {readable:,} could be read, {whole:,} went through all stages; {faults} failed")
    sys.exit(bool(faults))


if __name__ == "__main__":
    main()
