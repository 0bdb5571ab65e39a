"""Changes each line of the core, one at a time, and lists the changes that no test detects: `make mutants`.

    python -m tests.rigs.mutants [FILE ...] [--sample N] [--seconds N] [--processes N]

The rig works in copies of the checkout. mutants.toml lists the tests for each file. It also explains why some mutants
that live do no harm; these are not tried. Each mutant is first tried with the fastest tests that run its line. If it
lives, all other tests that may run the line follow. The exit code is 1 if an unexplained mutant lives.
"""

from __future__ import annotations

import argparse
import os
import random
import sys
import tempfile
import time
from collections import Counter
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor, as_completed
from dataclasses import dataclass
from fnmatch import fnmatch
from pathlib import Path
from queue import SimpleQueue
from typing import Any

from tests.support import REPOSITORY
from tests.support.mutation_worker import CODE, Worker
from tests.support.mutations import Mutant, mutants_of

if sys.version_info >= (3, 11):
    import tomllib
else:
    import tomli as tomllib

PLAN = REPOSITORY / "tests" / "rigs" / "mutants.toml"
SLACK = 20
"""Seconds that the tests of a mutant may take in addition to three times their usual duration."""
QUICK = 2
"""The largest total duration in seconds of the first tests of a mutant."""


@dataclass
class Group:
    """A group of files, and the tests that may detect their mutants.

    `tests` run without the extension in C, and `native` with it. `known` has the lines that each test runs, and its
    duration. Both are measured at the start.
    """

    files: list[str]
    tests: list[str]
    native: list[str]
    seconds: float = 0.0
    known: dict[str, Any] | None = None

    def tests_of(self, mutant: Mutant) -> list[tuple[list[str], float]]:
        """Return the tests for a mutant in groups, each with its seconds. The fastest tests of its line come first.

        The second group has all other tests that may run the line. A test whose lines are not completely recorded may
        run any line. For code that runs when a module is loaded, return all tests.
        """
        certain, possible = [], []
        for name, test in (self.known or {}).items():
            if any(mutant.line <= line <= mutant.last for line in test["lines"].get(mutant.file, ())):
                certain.append((test["seconds"], name))
            elif test["elsewhere"]:
                possible.append((test["seconds"], name))
        if not (certain and mutant.where):
            return [(self.tests, self.seconds)]
        certain.sort()
        first = 1
        while first < len(certain) and sum(seconds for seconds, _ in certain[: first + 1]) < QUICK:
            first += 1
        parts = [certain[:first], certain[first:] + possible]
        return [([name for _, name in part], sum(seconds for seconds, _ in part)) for part in parts if part]


def plan() -> tuple[list[Group], dict[tuple[str, ...], str]]:
    """Return the groups of files in mutants.toml, and for the key of each harmless mutant the reason."""
    table = tomllib.loads(PLAN.read_text())
    every = sorted(str(file.relative_to(REPOSITORY / CODE)) for file in (REPOSITORY / CODE).rglob("*.py"))
    groups: list[Group] = []
    for entry in table["group"]:
        others = {file for group in groups for file in group.files}
        matching = [file for file in every if any(fnmatch(file, pattern) for pattern in entry["files"])]
        groups.append(Group([file for file in matching if file not in others], entry["tests"], entry.get("native", [])))
    return groups, {(it["file"], *change): it["why"] for it in table["harmless"] for change in it["changes"]}


def try_all(mutants: list[Mutant], groups: list[Group], processes: int, seconds: float) -> Iterator[tuple[Mutant, str]]:
    """Yield each mutant with its result: killed, hung, lives, or not tried because the time is over."""
    end = time.monotonic() + seconds
    group_of = {file: group for group in groups for file in group.files}
    workers: SimpleQueue[Worker] = SimpleQueue()

    def learn(group: Group) -> None:
        worker = workers.get()
        try:
            group.seconds, group.known = worker.learn(group.tests, group.files)
        finally:
            workers.put(worker)

    def try_mutant(mutant: Mutant) -> tuple[Mutant, str]:
        if time.monotonic() > end:
            return mutant, "not tried"
        worker = workers.get()
        try:
            result = "lives"
            group = group_of[mutant.file]
            for tests, duration in group.tests_of(mutant):
                if result == "lives":
                    result = worker.try_(mutant, tests, 3 * duration + SLACK)
            if result == "lives" and group.native:
                result = worker.try_(mutant, group.native, 3 * group.seconds + SLACK, pure=False)
            return mutant, result
        finally:
            workers.put(worker)

    with tempfile.TemporaryDirectory(prefix="shmgen-mutants") as folder:
        os.chmod(folder, 0o755)  # tests that become other users read the copies
        every = [Worker(Path(folder) / str(number)) for number in range(processes)]
        for worker in every:
            workers.put(worker)
        try:
            with ThreadPoolExecutor(processes) as pool:
                list(pool.map(learn, {id(group_of[mutant.file]): group_of[mutant.file] for mutant in mutants}.values()))
                for job in as_completed([pool.submit(try_mutant, mutant) for mutant in mutants]):
                    yield job.result()
        finally:
            for worker in every:
                worker.close()


def main() -> None:
    """Try the mutants. Print each mutant that lives, and a line for each file."""
    parser = argparse.ArgumentParser(description="Lists the mutants that no test detects.")
    parser.add_argument("files", nargs="*", help="relative to src/shmgen, with * and ?; all that mutants.toml names")
    parser.add_argument("--sample", type=int, help="number of mutants, selected at random")
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--seconds", type=float, default=float("inf"), help="after which no further mutant is tried")
    parser.add_argument("--processes", type=int, default=os.cpu_count())
    args = parser.parse_args()
    groups, harmless = plan()
    files = [file for group in groups for file in group.files if any(fnmatch(file, p) for p in args.files or ["*"])]
    if not files:
        parser.error(f"mutants.toml names no file that matches {' '.join(args.files)}")
    every = [mutant for file in files for mutant in mutants_of(file, (REPOSITORY / CODE / file).read_bytes())]
    mutants = [mutant for mutant in every if mutant.key not in harmless]
    print(f"{len(every)} mutants of {len(files)} files, {len(every) - len(mutants)} explained", flush=True)
    if args.sample is not None and args.sample < len(mutants):
        mutants = sorted(random.Random(args.seed).sample(mutants, args.sample))
    counts: dict[str, Counter[str]] = {file: Counter() for file in files}
    for done, (mutant, result) in enumerate(try_all(mutants, groups, args.processes, args.seconds), 1):
        counts[mutant.file][result] += 1
        if result in ("lives", "hung"):  # on a busy machine, a hang proves nothing
            print(f"{result}: {mutant}", flush=True)
        if done % 50 == 0:
            print(f"{done} of {len(mutants)}", flush=True)
    for file, count in counts.items():
        if count:
            print(f"{file}: {', '.join(f'{number} {result}' for result, number in sorted(count.items()))}")
    total = sum(counts.values(), Counter())
    print(f"{total['killed']} killed, {total['hung']} hung, {total['lives']} live, {total['not tried']} not tried")
    sys.exit(bool(total["lives"]))


if __name__ == "__main__":
    main()
