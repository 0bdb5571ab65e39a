"""Python and a PLC among peers that are killed, short; `make chaos` has ten thousand calls for each scene."""

from __future__ import annotations

import pytest

from ..support.plc_calls import Calls
from . import chaos, chaos_ends


@pytest.mark.slow
@pytest.mark.parametrize(
    ("scene", "seconds"),
    [
        *(("python_alone", 3.0), ("plc_serves", 10.0), ("plc_asks", 5.0), ("plc_alone", 5.0)),
        *(("python_goals", 3.0), ("plc_serves_goals", 10.0), ("plc_sends_goals", 5.0), ("plc_goals", 5.0)),
    ],
)
def test_every_call_ends_and_none_in_the_answer_to_another(
    compiled_calls: Calls, monkeypatch: pytest.MonkeyPatch, scene: str, seconds: float
) -> None:
    """How late a call may end is wide here, where other tests take the processors."""
    monkeypatch.setattr(chaos_ends, "SLACK", 10.0)
    replies = kills = 0
    for seed in range(1, 9):  # the first will do, but where others take the processors most calls run into their limit
        verdict = chaos.run(compiled_calls.folder, scene, 10_000, seed=seed, longest=seconds)
        assert not verdict.complaints, verdict
        replies, kills = replies + verdict.ends["r"], kills + verdict.kills.total()
        if replies > 20 and kills >= 2:
            break
    assert replies > 20, verdict
    assert kills >= 2, verdict


@pytest.mark.parametrize(
    ("scene", "fault", "found"),
    [
        ("python_alone", "python_client", "got the answer to another"),
        ("python_alone", "python_server", "was there before the server that served it"),
        ("python_goals", "python_numbers", "got the answer to another"),
        ("plc_asks", "any_reply", "got the answer to another"),
    ],
)
@pytest.mark.family("[plc_asks")
def test_a_planted_fault_is_found(compiled_calls: Calls, scene: str, fault: str, found: str) -> None:
    """A PLC that answers old calls is found by plc/test_services.py; here it takes its time."""
    verdict = chaos.run(compiled_calls.folder, scene, 10**6, seed=1, fault=fault, longest=120.0)
    assert any(found in complaint for complaint in verdict.complaints), verdict
