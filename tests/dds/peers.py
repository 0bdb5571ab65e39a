"""Build two programs without code of shmgen from message definitions: on Fast DDS and on Cyclone's C library."""

from __future__ import annotations

import os
import shutil
import subprocess
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path

from shmgen.core.model import Message, TypeName

from ..support import kept
from ..support.dds import LOOPBACK
from ..support.ros1 import Bridge
from .idl import idl, scoped

HERE = Path(__file__).parent
NEEDS = {"fast": ("fastddsgen", "g++"), "cyclone": ("idlc", "gcc")}


def missing(maker: str) -> str:
    """Return the name of a build tool that is not installed, or `""`."""
    return next((tool for tool in NEEDS[maker] if not shutil.which(tool)), "")


def build(maker: str, folder: Path, messages: Sequence[Message], topics: Sequence[TypeName]) -> Path:
    """Build the program, only once even if several workers request it at the same time."""
    program = folder / f"{maker}_peer"
    with kept.locked(folder / f"{maker}.lock"):
        if not program.exists():
            build_folder = folder / maker
            build_folder.mkdir(exist_ok=True)
            (build_folder / "peer.idl").write_text(idl(messages))
            {"fast": _fast, "cyclone": _cyclone}[maker](build_folder, topics)
            (build_folder / "peer").rename(program)
    return program


def _fast(folder: Path, topics: Sequence[TypeName]) -> None:
    _run(folder, "fastddsgen", "-cs", "-replace", "-t", str(folder), "-d", str(folder), "peer.idl")
    types = ", ".join(f"new {scoped(name)}PubSubType()" for name in topics)
    sources = ["peer.cxx", "peerPubSubTypes.cxx", str(HERE / "fast_peer.cpp")]
    flags = ["-O0", "-w", "-I.", f"-DPEER_TYPES={types}", "-lfastrtps", "-lfastcdr"]
    _run(folder, "g++", "-o", "peer", *sources, *flags)


def _cyclone(folder: Path, topics: Sequence[TypeName]) -> None:
    _run(folder, "idlc", "-x", "final", "peer.idl")
    types = ", ".join(f"&{scoped(name).replace('::', '_')}_desc" for name in topics)
    flags = ["-O0", "-w", "-I.", f"-DPEER_TYPES={types}", "-lddsc"]
    _run(folder, "gcc", "-o", "peer", "peer.c", str(HERE / "cyclone_peer.c"), *flags)


def _run(folder: Path, *command: str) -> None:
    result = subprocess.run(command, cwd=folder, capture_output=True, text=True, check=False)
    assert result.returncode == 0, f"{command}: {result.stdout[-3000:]}{result.stderr[-3000:]}"


@contextmanager
def running(program: Path, *words: object) -> Iterator[Bridge]:
    """Start the peer, yield it when it is ready, and kill it afterwards."""
    environment = {**os.environ, "CYCLONEDDS_URI": LOOPBACK}
    command = [str(program), *map(str, words)]
    with subprocess.Popen(command, stdin=-1, stdout=-1, stderr=-2, text=True, env=environment) as process:
        peer = Bridge(process)
        try:
            peer.wait_for_line("ready")
            yield peer
        finally:
            process.kill()
