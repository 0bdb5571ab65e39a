"""What lies in a region never makes a reader in C or C++ leave it; `python -m tests.cpp.hostile` is the long one."""

from __future__ import annotations

from pathlib import Path

import pytest

from . import hostile


@pytest.fixture(scope="module")
def program(generated: Path) -> Path:
    folder = generated / "hostile"
    folder.mkdir(exist_ok=True)
    return hostile.program(folder)


@pytest.mark.slow
def test_a_region_may_hold_anything(program: Path) -> None:
    done = hostile.run([program, 10_000, 7])
    assert done.returncode == 0, done.stderr[:3000]
    assert "10000 inputs" in done.stdout
    taken, refused = int(done.stdout.split()[2]), int(done.stdout.split()[5])
    assert taken > 10_000  # else the readers have left the region
    assert refused > 0


@pytest.mark.slow
def test_a_reader_that_believes_a_count_is_found(program: Path) -> None:
    done = hostile.run([program, 10_000, 7], PLANTED="1")
    assert done.returncode != 0
    assert "ERROR: AddressSanitizer" in done.stderr or "runtime error" in done.stderr
