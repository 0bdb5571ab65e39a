"""The shorter proofs. `make prove` goes through all."""

from __future__ import annotations

import shutil
from pathlib import Path

import pytest

from .eva import HARNESSES, Harness, generate, said

SHORT = {"lock", "write"}


@pytest.mark.slow
@pytest.mark.parametrize("harness", [it for it in HARNESSES if it.name in SHORT], ids=lambda it: it.name)
def test_it_holds_and_finds_its_fault(harness: Harness, tmp_path: Path) -> None:
    if not shutil.which("frama-c"):
        pytest.skip("no frama-c: apt-get install frama-c-base")
    headers = generate(tmp_path)
    proof = said(harness, headers)
    assert proof.holds, proof
    assert proof.statements > 90
    assert not said(harness, headers, planted=True).holds
