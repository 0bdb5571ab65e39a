"""Who means something else by a type is refused until all is taken that it has sent, whatever the graph says then."""

from __future__ import annotations

from collections.abc import Iterator

import pytest

from shmgen.bridge.codec.type_identity import Identity
from shmgen.bridge.common.peers import Peers
from shmgen.core.model import TypeName

OURS, OTHER = "RIHS01_" + "1" * 64, "RIHS01_" + "2" * 64
FRIEND, STRANGER = b"friend", b"stranger"
GRAPH = [{FRIEND: OURS}, {FRIEND: OURS, STRANGER: OTHER}, {FRIEND: OURS}, {FRIEND: OURS}]


@pytest.fixture
def graph() -> Iterator[dict[bytes, str]]:
    return iter(GRAPH)


def peers(graph: Iterator[dict[bytes, str]], met: list[str], accepts_other: bool = False) -> Peers:
    identity = Identity("/t", TypeName("p", "msg", "T"), OURS, lambda line: None, accepts_other)
    return Peers(identity, met.append, lambda: next(graph))


def test_a_stranger_that_has_gone_counts_until_all_is_taken(graph: Iterator[dict[bytes, str]]) -> None:
    met: list[str] = []
    made = peers(graph, met)
    made.look()
    assert (made.refusal(), made.refusal(FRIEND), met) == ("", "", [])
    for is_there in (True, False):  # it has come, and has gone
        made.look()
        assert OTHER in made.refusal()
        assert OTHER in made.refusal(STRANGER)
        assert made.refusal(FRIEND) == ""
        assert (OTHER in met[-1]) == is_there
    made.forget()
    made.look()
    assert made.refusal() == ""
    assert "left before its type could be compared" in made.refusal(STRANGER)


def test_what_is_accepted(graph: Iterator[dict[bytes, str]]) -> None:
    made = peers(graph, met := [], accepts_other=True)
    for _ in GRAPH:
        made.look()
        assert made.refusal(b"unknown") == made.refusal(STRANGER) == made.refusal() == ""
    assert not any(met)
