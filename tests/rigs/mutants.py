"""Changes each line of the core, one at a time, and lists the changes that no test detects: `make mutants`.

    python -m tests.rigs.mutants [FILE ...] [--sample N] [--seconds N] [--processes N]

All happens in copies of the checkout. mutants.toml lists the tests for each file. It also explains why some mutants
that live do no harm; these are not tried. A mutant first meets the fastest tests that run its line. If it lives, it
meets all other tests that may run the line. The exit code is 1 if a mutant lives that mutants.toml does not explain.
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
"""Seconds that tests of a mutant may last beyond three times what they last without one."""
QUICK = 2
"""Seconds that the first tests of a mutant last together, at most."""


@dataclass
class Room:
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
        run, may = [], []
        for name, test in (self.known or {}).items():
            if any(mutant.line <= line <= mutant.last for line in test["lines"].get(mutant.file, ())):
                run.append((test["seconds"], name))
            elif test["elsewhere"]:
                may.append((test["seconds"], name))
        if not (run and mutant.where):
            return [(self.tests, self.seconds)]
        run.sort()
        first = 1
        while first < len(run) and sum(seconds for seconds, _ in run[: first + 1]) < QUICK:
            first += 1
        parts = [run[:first], run[first:] + may]
        return [([name for _, name in part], sum(seconds for seconds, _ in part)) for part in parts if part]


def plan() -> tuple[list[Room], list[dict[str, str]]]:
    """Return the groups of files in mutants.toml, and the mutants that it explains.

    A file belongs to the first group that names it.
    """
    said = tomllib.loads(PLAN.read_text())
    every = sorted(str(file.relative_to(REPOSITORY / CODE)) for file in (REPOSITORY / CODE).rglob("*.py"))
    rooms: list[Room] = []
    for entry in said["room"]:
        taken = {file for room in rooms for file in room.files}
        matching = [file for file in every if any(fnmatch(file, pattern) for pattern in entry["files"])]
        rooms.append(Room([file for file in matching if file not in taken], entry["tests"], entry.get("native", [])))
    return rooms, said.get("survivor", [])


def unexplained(mutants: list[Mutant], survivors: list[dict[str, str]]) -> tuple[list[Mutant], list[dict[str, str]]]:
    """Return the mutants that mutants.toml does not explain, and its explanations of mutants that do not exist."""
    keys = [(entry["file"], entry["where"], entry["was"], entry["now"]) for entry in survivors]
    known = {mutant.key for mutant in mutants}
    stale = [entry for key, entry in zip(keys, survivors, strict=True) if key not in known]
    return [mutant for mutant in mutants if mutant.key not in keys], stale


def tried(mutants: list[Mutant], rooms: list[Room], processes: int, seconds: float) -> Iterator[tuple[Mutant, str]]:
    """Yield each mutant with its result: killed, hung, lives, or not tried because the time is over."""
    end = time.monotonic() + seconds
    room_of = {file: room for room in rooms for file in room.files}
    workers: SimpleQueue[Worker] = SimpleQueue()

    def learn(room: Room) -> None:
        worker = workers.get()
        try:
            room.seconds, room.known = worker.learn(room.tests, room.files)
        finally:
            workers.put(worker)

    def one(mutant: Mutant) -> tuple[Mutant, str]:
        if time.monotonic() > end:
            return mutant, "not tried"
        worker = workers.get()
        try:
            how = "lives"
            room = room_of[mutant.file]
            for tests, spent in room.tests_of(mutant):
                if how == "lives":
                    how = worker.try_(mutant, tests, 3 * spent + SLACK)
            if how == "lives" and room.native:
                how = worker.try_(mutant, room.native, 3 * room.seconds + SLACK, pure=False)
            return mutant, how
        finally:
            workers.put(worker)

    with tempfile.TemporaryDirectory(prefix="shmgen-mutants") as folder:
        os.chmod(folder, 0o755)  # tests that become other users read the copies
        every = [Worker(Path(folder) / str(number)) for number in range(processes)]
        for worker in every:
            workers.put(worker)
        try:
            with ThreadPoolExecutor(processes) as pool:
                list(pool.map(learn, {id(room_of[mutant.file]): room_of[mutant.file] for mutant in mutants}.values()))
                for job in as_completed([pool.submit(one, mutant) for mutant in mutants]):
                    yield job.result()
        finally:
            for worker in every:
                worker.close()


def main() -> None:
    """Try the mutants. Print each mutant that lives, and a line for each file."""
    parser = argparse.ArgumentParser(description="Lists the mutants that no test minds.")
    parser.add_argument("files", nargs="*", help="relative to src/shmgen, with * and ?; all that mutants.toml names")
    parser.add_argument("--sample", type=int, help="so many, drawn at random")
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--seconds", type=float, default=float("inf"), help="after which no more are tried")
    parser.add_argument("--processes", type=int, default=os.cpu_count())
    given = parser.parse_args()
    rooms, survivors = plan()
    files = [file for room in rooms for file in room.files if any(fnmatch(file, p) for p in given.files or ["*"])]
    every = [mutant for file in files for mutant in mutants_of(file, (REPOSITORY / CODE / file).read_bytes())]
    mutants, _ = unexplained(every, survivors)
    print(f"{len(every)} mutants of {len(files)} files, {len(every) - len(mutants)} explained", flush=True)
    if given.sample is not None and given.sample < len(mutants):
        mutants = sorted(random.Random(given.seed).sample(mutants, given.sample))
    counts: dict[str, Counter[str]] = {file: Counter() for file in files}
    for done, (mutant, how) in enumerate(tried(mutants, rooms, given.processes, given.seconds), 1):
        counts[mutant.file][how] += 1
        if how in ("lives", "hung"):  # a machine may be too busy for one that hangs, which is then no proof
            print(f"{how}: {mutant}", flush=True)
        if done % 50 == 0:
            print(f"{done} of {len(mutants)}", flush=True)
    for file, count in counts.items():
        if count:
            print(f"{file}: {', '.join(f'{number} {how}' for how, number in sorted(count.items()))}")
    total = sum(counts.values(), Counter())
    print(f"{total['killed']} killed, {total['hung']} hung, {total['lives']} live, {total['not tried']} not tried")
    sys.exit(bool(total["lives"]))


if __name__ == "__main__":
    main()
