"""Fuzzes the parsers of definitions and of foreign files with atheris, guided by coverage: `make fuzz`.

The seeds are the corpus of real definitions, and for foreign files the seeds of tests/support/foreign.py. Each input
must result in a schema or in a diagnostic, in a short time. Every 50th valid definition goes through all stages. Inputs
that fail are stored in .fuzz/.
"""

from __future__ import annotations

import sys
import tempfile
from collections.abc import Callable
from pathlib import Path

import atheris

with atheris.instrument_imports(include=["shmgen"]):
    from shmgen.generator import pipeline  # noqa: F401
    from shmgen.targets.st import target as st  # noqa: F401
    from tests.support import foreign

from tests.support import REPOSITORY, SHARED
from tests.support.definitions import KINDS, SOURCES, TOKENS, Fuzzed, generated, read

SLOW = 10
"""The timeout of one input in seconds of wall-clock time, because libFuzzer does not measure CPU time."""


def main(seconds: int, kind: str) -> None:
    results = REPOSITORY / ".fuzz"
    seeds = results / f"seeds-{kind}"
    seeds.mkdir(parents=True, exist_ok=True)
    contents = first_seeds() if kind == "definitions" else foreign.seeds(kind)
    for number, seed in enumerate(contents):
        (seeds / f"{number:03d}").write_bytes(seed)
    dictionary = results / f"words-{kind}"
    tokens = TOKENS if kind == "definitions" else foreign.TOKENS
    dictionary.write_text("".join(f'"{escape(token)}"\n' for token in dict.fromkeys(tokens)))
    options = [f"-max_total_time={seconds}", f"-timeout={SLOW}", f"-artifact_prefix={results}/{kind}-"]
    options += [f"-dict={dictionary}", "-max_len=4096", "-print_final_stats=1", str(seeds)]
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        target: Callable[[bytes], object] = Target(folder)
        if kind != "definitions":
            target = lambda data: foreign.read(kind, data, folder)  # noqa: E731
        atheris.Setup([sys.argv[0], *options], target)
        atheris.Fuzz()


def first_seeds() -> list[bytes]:
    """Return the real definitions, each after the byte with which Target selects kind and distribution."""
    files = sorted((SHARED / "corpus").glob("*/*/*/*.[msa]*"))
    firsts = [KINDS.index(file.suffix[1:]) + len(KINDS) * ("noetic" in file.parts) for file in files]
    return [bytes([first]) + file.read_bytes() for first, file in zip(firsts, files, strict=True)]


def escape(token: str) -> str:
    return "".join(f"\\x{byte:02x}" for byte in token.encode() or b" ")


class Target:
    """Parses the inputs of the fuzzer. The first byte of an input selects the kind of file and the distribution."""

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        self.readable = 0

    def __call__(self, data: bytes) -> None:
        number = data[0] % (len(KINDS) * len(SOURCES)) if data else 0
        fuzzed = Fuzzed(data[1:], KINDS[number % len(KINDS)], SOURCES[number // len(KINDS)])
        if read(fuzzed, self.folder) is not None:
            self.readable += 1
            if self.readable % 50 == 0:
                generated(fuzzed, self.folder, ("python", "st", "plcopen", "c", "cpp"))


if __name__ == "__main__":
    main(int(sys.argv[1]), sys.argv[2])
