"""Readers in C and C++ never access memory outside a region. `python -m tests.cpp.hostile` tests more inputs."""

from __future__ import annotations

from pathlib import Path

import pytest

from . import hostile


@pytest.fixture(scope="module")
def program(generated: Path) -> Path:
    folder = generated / "hostile"
    folder.mkdir(exist_ok=True)
    return hostile.make_fuzzer(folder)


@pytest.mark.slow
def test_readers_accept_or_refuse_arbitrary_bytes(program: Path) -> None:
    process = hostile.run([program, 10_000, 7])
    assert process.returncode == 0, process.stderr[:3000]
    assert "10000 inputs" in process.stdout
    accepted, refused = int(process.stdout.split()[2]), int(process.stdout.split()[5])
    assert accepted > 10_000  # otherwise, the readers have abandoned the region
    assert refused > 0


@pytest.mark.slow
def test_sanitizer_detects_a_reader_that_trusts_a_count(program: Path) -> None:
    process = hostile.run([program, 10_000, 7], PLANTED="1")
    assert process.returncode != 0
    assert "ERROR: AddressSanitizer" in process.stderr or "runtime error" in process.stderr
