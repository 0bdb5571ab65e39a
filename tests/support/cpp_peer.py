"""Programs in C and C++ for tests: generate their headers, compile once in a session, and talk to a peer process."""

from __future__ import annotations

import os
import shutil
import subprocess
from collections.abc import Mapping, Sequence
from contextlib import suppress
from dataclasses import replace
from pathlib import Path

from shmgen.config import Config
from shmgen.core.model import Layouts
from shmgen.generator import pipeline

from . import kept
from .build import put
from .plc_demo import MESSAGES, PACKAGE

HERE = Path(__file__).parents[1] / "cpp"
STRICT = ["-Wall", "-Wextra", "-Wpedantic", "-Wconversion", "-Wshadow", "-Werror"]
COMPILERS = [name for name in ("g++", "clang++") if shutil.which(name)]


def generate(folder: Path, messages: Mapping[str, str] | None = None, **settings: object) -> Layouts:
    """Generate C and C++ below `folder` for definitions by path. The default is the package of plc_demo."""
    demo = {f"demo_msgs/msg/{name}.msg": text for name, text in MESSAGES.items()}
    put(demo if messages is None else messages, folder)
    config = replace(Config(folder, source="jazzy", path=(folder,), package=PACKAGE, targets=("c", "cpp")), **settings)
    package = "demo_msgs" if messages is None else next(iter(messages)).partition("/")[0]
    put(pipeline.generate(config, [package]), folder)
    return pipeline.lay_out(config, [package])


def compiled(folder: Path, name: str, *sources: Path, options: Sequence[str] = (), compiler: str = "g++") -> Path:
    """Compile a program from C11 and C++17, once in a session. Warnings are errors."""
    program = folder / name
    with kept.locked(folder / f"{name}.lock"):
        if program.exists():
            return program
        objects = []
        include = [f"-I{folder}/c", f"-I{folder}/cpp", f"-I{HERE}"]
        for source in sources:
            objects.append(folder / f"{name}-{source.stem}.o")
            is_c = source.suffix == ".c"
            tool = {"g++": "gcc", "clang++": "clang"}.get(compiler, compiler) if is_c else compiler
            standard = "-std=c11" if is_c else "-std=c++17"
            _run(tool, standard, *STRICT, "-O1", "-g", *options, *include, "-c", source, "-o", objects[-1])
        _run(compiler, *options, *objects, "-o", f"{program}.new", "-lrt", "-lpthread")
        os.rename(f"{program}.new", program)
    return program


def _run(*command: object) -> None:
    done = subprocess.run([str(word) for word in command], capture_output=True, text=True, check=False)
    assert done.returncode == 0, f"{' '.join(map(str, command))}\n{done.stderr[:6000]}"


class Peer:
    """A process of tests/cpp/peer.cpp."""

    def __init__(self, program: Path, language: str = "cpp", before: Sequence[str] = (), **options: object) -> None:
        self.language = language
        command = [*before, str(program)]
        self.process = subprocess.Popen(
            command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True, bufsize=1, **options
        )

    @property
    def pid(self) -> int:
        return self.process.pid

    def tell(self, line: str) -> None:
        assert self.process.stdin
        self.process.stdin.write(f"{line}\n")
        self.process.stdin.flush()

    def hear(self) -> str:
        assert self.process.stdout
        return self.process.stdout.readline().rstrip("\n")

    def ask(self, line: str) -> str:
        self.tell(line)
        return self.hear()

    def opens(self, name: str, role: str, topic: str, *options: str) -> int:
        """Open an endpoint and return the status."""
        return int(self.ask(f"open {name} {self.language} {role} {topic} {' '.join(options)}").split()[0])

    def does(self, line: str) -> int:
        """Execute a command and return its status."""
        return int(self.ask(line).split()[0])

    def reads(self, line: str) -> list[str] | None:
        """Read a sample and return `a b label tail...`, or None if there is no new sample."""
        status, *values = self.ask(line).split()
        assert status in ("0", "100"), (status, values)
        return values if status == "0" else None

    def kill(self) -> None:
        self.process.kill()
        self.process.wait()

    def close(self) -> None:
        """End the process."""
        assert self.process.stdin
        assert self.process.stdout
        with suppress(BrokenPipeError):
            self.process.stdin.close()
        try:
            self.process.wait(10)
        finally:
            self.process.kill()
            self.process.wait()
            self.process.stdout.close()
