"""Fuzzes the readers of definitions with atheris, guided by coverage: `make fuzz`.

The seeds are the corpus of real definitions. Each input must end in a schema or in a diagnostic, and soon; every 50th
that can be read goes through all stages. What fails is kept in .fuzz/.
"""

from __future__ import annotations

import sys
import tempfile
from pathlib import Path

import atheris

with atheris.instrument_imports(include=["shmgen"]):
    from shmgen.generator import pipeline  # noqa: F401
    from shmgen.targets.st import target as st  # noqa: F401

from tests.conftest import REPOSITORY, SHARED
from tests.support.definitions import KINDS, SOURCES, TOKENS, Fuzzed, generated, read

SLOW = 10
"""Seconds for one input, of the wall clock; libFuzzer knows no other."""


def main(seconds: int) -> None:
    kept = REPOSITORY / ".fuzz"
    seeds = kept / "seeds"
    seeds.mkdir(parents=True, exist_ok=True)
    for number, file in enumerate(sorted((SHARED / "corpus").glob("*/*/*/*.[msa]*"))):
        first = KINDS.index(file.suffix[1:]) + len(KINDS) * ("noetic" in file.parts)
        (seeds / f"{number:03d}").write_bytes(bytes([first]) + file.read_bytes())
    dictionary = kept / "words"
    dictionary.write_text("".join(f'"{escaped(token)}"\n' for token in dict.fromkeys(TOKENS)))
    options = [f"-max_total_time={seconds}", f"-timeout={SLOW}", f"-artifact_prefix={kept}/", f"-dict={dictionary}"]
    with tempfile.TemporaryDirectory() as folder:
        atheris.Setup(
            [sys.argv[0], *options, "-max_len=4096", "-print_final_stats=1", str(seeds)], Target(Path(folder))
        )
        atheris.Fuzz()


def escaped(token: str) -> str:
    return "".join(f"\\x{byte:02x}" for byte in token.encode() or b" ")


class Target:
    """The first byte of an input chooses the kind of file and the distribution."""

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
    main(int(sys.argv[1]) if len(sys.argv) > 1 else 300)
