"""The peer in C and C++, compiled once in a session for all workers. Its processes end with their test."""

from __future__ import annotations

import os
import shutil
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest

from ..support import cpp_peer, kept
from ..support.cpp_peer import Peer


@pytest.fixture(scope="session")
def generated(tmp_path_factory: pytest.TempPathFactory, worker_id: str) -> Path:
    """A folder with generated C and C++ for the messages of plc_demo."""
    if shutil.which("g++") is None:
        pytest.skip("g++ is not installed")
    base = tmp_path_factory.getbasetemp()
    folder = (base if worker_id == "master" else base.parent) / "cpp"
    with kept.locked(folder / "lock"):
        if not (folder / "cpp").exists():
            cpp_peer.generate(folder)
    return folder


SANITIZE = os.environ.get("SHMGEN_SANITIZE", "")
"""`address,undefined`, say: the peer with sanitizers looking on."""


@pytest.fixture(scope="session")
def program(generated: Path) -> Path:
    options = [f"-fsanitize={SANITIZE}", "-fno-sanitize-recover=all"] if SANITIZE else []
    return cpp_peer.compiled(generated, "peer", cpp_peer.HERE / "peer.cpp", cpp_peer.HERE / "ends.c", options=options)


@pytest.fixture
def peer(program: Path) -> Iterator[Callable[..., Peer]]:
    """A function that starts a peer: `peer("c")`."""
    started: list[Peer] = []

    def start(language: str = "cpp") -> Peer:
        started.append(Peer(program, language))
        return started[-1]

    yield start
    for process in started:
        process.close()


@pytest.fixture(params=["c", "cpp"])
def language(request: pytest.FixtureRequest) -> str:
    return str(request.param)
