"""Every message of the corpus passes unchanged from Python through generated ST and back, and into the C header."""

from __future__ import annotations

from pathlib import Path

import pytest

from shmgen.config import Config
from shmgen.config.entries import Bound, Bounds
from shmgen.core.diagnostics import Span

from ..support import plc_bytes

BOUND = 3
"""The bound of all sequences that have no bound in their definitions."""


@pytest.mark.sample("[noetic")
@pytest.mark.parametrize(("distribution", "count"), [("noetic", 221), ("jazzy", 624)])
def test_corpus_messages_pass_through_st_unchanged(
    distribution: str, count: int, corpus: Path, tmp_path_factory: pytest.TempPathFactory, topic: str
) -> None:
    """Test all messages of a distribution together, because their compilation takes 20 s to 50 s."""
    folder = corpus / distribution
    bounds = Bounds({}, {path.name: Bound(BOUND, Span("shmgen.toml")) for path in folder.iterdir()})
    config = Config(corpus, source=distribution, path=(folder,), package=f"shm_corpus_{distribution}", bounds=bounds)
    proof = plc_bytes.make(config, plc_bytes.corpus_names(config), tmp_path_factory.mktemp(distribution))
    assert len(list(proof.requested())) == count
    plc_bytes.prove(proof, topic)
