"""What C and C++ do with a region whose every byte may be anything.

    python -m tests.cpp.hostile [--inputs 1000000] [--seed 1]

By libFuzzer where clang has it, which looks for inputs that take new ways; and by inputs of our own. Address and
undefined-behaviour sanitizers look on.
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


def program(folder: Path, libfuzzer: bool = False) -> Path:
    """Compiled in `folder`."""
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
    """And what it leaves in /dev/shm."""
    name = f"shmgen_test.t{uuid.uuid4().hex}"
    try:
        words = [str(word) for word in command]
        environment = {**os.environ, "TOPIC": f"/{name.replace('.', '/')}", **environment}
        return subprocess.run(words, capture_output=True, text=True, check=False, env=environment)
    finally:
        for file in Path("/dev/shm").glob(f"*{name}*"):
            file.unlink()


def main() -> None:
    """Exit code 1 if a sanitizer complained."""
    parser = argparse.ArgumentParser()
    parser.add_argument("--inputs", type=int, default=1_000_000)
    parser.add_argument("--seed", type=int, default=1)
    given = parser.parse_args()
    with tempfile.TemporaryDirectory(prefix="shmgen-hostile") as name:
        folder = Path(name)
        results = [run([program(folder), given.inputs, given.seed])]
        if shutil.which("clang++"):
            results.append(
                run([program(folder, libfuzzer=True), f"-runs={given.inputs}", f"-seed={given.seed}", "-max_len=241"])
            )
        else:
            print("no clang++, so no libFuzzer")
    for result in results:
        print(result.stdout, *result.stderr.splitlines()[-2:], sep="\n")
    sys.exit(any(result.returncode for result in results))


if __name__ == "__main__":
    main()
