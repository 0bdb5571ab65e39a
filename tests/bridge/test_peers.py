"""Test that an incompatible peer is refused until all its messages are processed, even after it left the graph."""

from __future__ import annotations

from collections.abc import Iterator

import pytest

from shmgen.bridge.codec.type_identity import Identity
from shmgen.bridge.common.peers import Peers
from shmgen.core.model import TypeName

OURS, OTHER = "RIHS01_" + "1" * 64, "RIHS01_" + "2" * 64
COMPATIBLE, INCOMPATIBLE = b"friend", b"stranger"
GRAPH = [{COMPATIBLE: OURS}, {COMPATIBLE: OURS, INCOMPATIBLE: OTHER}, {COMPATIBLE: OURS}, {COMPATIBLE: OURS}]


@pytest.fixture
def graph() -> Iterator[dict[bytes, str]]:
    return iter(GRAPH)


def create_peers(graph: Iterator[dict[bytes, str]], reports: list[str], accepts_other: bool = False) -> Peers:
    identity = Identity("/t", TypeName("p", "msg", "T"), OURS, lambda line: None, accepts_other)
    return Peers(identity, reports.append, lambda: next(graph))


def test_departed_incompatible_peer_is_refused_until_forget(graph: Iterator[dict[bytes, str]]) -> None:
    reports: list[str] = []
    known_peers = create_peers(graph, reports)
    known_peers.look()
    assert (known_peers.refusal(), known_peers.refusal(COMPATIBLE), reports) == ("", "", [])
    for is_present in (True, False):  # the peer joins, then leaves
        known_peers.look()
        assert OTHER in known_peers.refusal()
        assert OTHER in known_peers.refusal(INCOMPATIBLE)
        assert known_peers.refusal(COMPATIBLE) == ""
        assert (OTHER in reports[-1]) == is_present
    known_peers.forget()
    known_peers.look()
    assert known_peers.refusal() == ""
    assert "left before its type could be compared" in known_peers.refusal(INCOMPATIBLE)


def test_another_definition_can_be_accepted(graph: Iterator[dict[bytes, str]]) -> None:
    known_peers = create_peers(graph, reports := [], accepts_other=True)
    for _ in GRAPH:
        known_peers.look()
        assert known_peers.refusal(b"unknown") == known_peers.refusal(INCOMPATIBLE) == known_peers.refusal() == ""
    assert not any(reports)
