"""The PLC among peers that are killed, short; `make chaos` has ten thousand calls for each scene."""

from __future__ import annotations

import pytest

from ..support.plc_calls import Calls
from . import plc_chaos


@pytest.mark.parametrize(("scene", "seconds"), [("plc_serves", 10.0), ("plc_asks", 5.0), ("plc_alone", 5.0)])
def test_every_call_ends_and_none_in_the_answer_to_another(
    compiled_calls: Calls, monkeypatch: pytest.MonkeyPatch, scene: str, seconds: float
) -> None:
    """How late a call may end is wide here, where other tests take the processors."""
    monkeypatch.setattr(plc_chaos, "SLACK", 10.0)
    replies = kills = 0
    for seed in range(1, 9):  # the first will do, but where others take the processors most calls run into their limit
        verdict = plc_chaos.run(compiled_calls.folder, scene, 10_000, seed=seed, longest=seconds)
        assert not verdict.complaints, verdict
        replies, kills = replies + verdict.ends["r"], kills + verdict.kills.total()
        if replies > 20 and kills >= 2:
            break
    assert replies > 20, verdict
    assert kills >= 2, verdict


def test_a_planted_fault_is_found(compiled_calls: Calls) -> None:
    """A server that answers old calls is found by plc/test_services.py; here it takes its time."""
    verdict = plc_chaos.run(compiled_calls.folder, "plc_asks", 10**6, seed=1, fault="any_reply", longest=120.0)
    assert any("got the answer to another" in complaint for complaint in verdict.complaints), verdict
