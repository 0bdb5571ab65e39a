"""Fuzz readers in C and C++ with a region whose bytes may have any value.

    python -m tests.cpp.hostile [--inputs 1000000] [--seed 1]

Our own generator creates inputs, and so does libFuzzer if clang is installed, which searches for inputs that reach new
code. The address and undefined-behaviour sanitizers detect errors.
"""

from __future__ import annotations

import argparse
import os
import shutil
import subprocess
import sys
import tempfile
import uuid
from pathlib import Path

from shmgen.config.entries import Bound, Bounds
from shmgen.core.diagnostics import Span

from ..support import cpp_peer

CASE = Path(__file__).parents[1] / "cases" / "everything" / "msgs"
SANITIZED = "-fsanitize=address,undefined", "-fno-sanitize-recover=all"


def make_fuzzer(folder: Path, libfuzzer: bool = False) -> Path:
    """Compile the fuzzer in `folder`."""
    if not (folder / "cpp").exists():
        texts = {str(path.relative_to(CASE)): path.read_text() for path in CASE.rglob("*.msg")}
        bounds = Bounds({}, {"demo_msgs": Bound(5, Span("shmgen.toml"))})
        cpp_peer.generate(folder, texts, package="shm_hostile", bounds=bounds)
    if libfuzzer:
        options = "-fsanitize=fuzzer,address,undefined", "-fno-sanitize-recover=all", "-DLIBFUZZER"
        return cpp_peer.compiled(folder, "fuzzed", SOURCE, options=options, compiler="clang++")
    return cpp_peer.compiled(folder, "hostile", SOURCE, options=SANITIZED)


SOURCE = cpp_peer.HERE / "hostile.cpp"


def run(command: list[object], **environment: str) -> subprocess.CompletedProcess[str]:
    """Run a command with a topic of its own, and remove its files from /dev/shm."""
    name = f"shmgen_test.t{uuid.uuid4().hex}"
    try:
        arguments = [str(word) for word in command]
        environment = {**os.environ, "TOPIC": f"/{name.replace('.', '/')}", **environment}
        return subprocess.run(arguments, capture_output=True, text=True, check=False, env=environment)
    finally:
        for file in Path("/dev/shm").glob(f"*{name}*"):
            file.unlink()


def main() -> None:
    """Exit with code 1 if a sanitizer reported an error."""
    parser = argparse.ArgumentParser()
    parser.add_argument("--inputs", type=int, default=1_000_000)
    parser.add_argument("--seed", type=int, default=1)
    args = parser.parse_args()
    with tempfile.TemporaryDirectory(prefix="shmgen-hostile") as name:
        folder = Path(name)
        results = [run([make_fuzzer(folder), args.inputs, args.seed])]
        if shutil.which("clang++"):
            results.append(
                run([make_fuzzer(folder, libfuzzer=True), f"-runs={args.inputs}", f"-seed={args.seed}", "-max_len=241"])
            )
        else:
            print("no clang++, so no libFuzzer")
    for result in results:
        print(result.stdout, *result.stderr.splitlines()[-2:], sep="\n")
    sys.exit(any(result.returncode for result in results))


if __name__ == "__main__":
    main()
