"""Tests of the shorter proofs. `make prove` runs all proofs."""

from __future__ import annotations

import shutil
from pathlib import Path

import pytest

from .eva import HARNESSES, Harness, generate, prove

SHORT = {"lock", "write"}


@pytest.mark.exhaustive
@pytest.mark.parametrize("harness", [it for it in HARNESSES if it.name in SHORT], ids=lambda it: it.name)
def test_proof_holds_and_detects_its_fault(harness: Harness, tmp_path: Path) -> None:
    if not shutil.which("frama-c"):
        pytest.skip("no frama-c: apt-get install frama-c-base")
    headers = generate(tmp_path)
    proof = prove(harness, headers)
    assert proof.holds, proof
    assert proof.statements > 90
    assert not prove(harness, headers, planted=True).holds
