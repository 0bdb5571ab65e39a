"""Short chaos runs of Python and a PLC. `make chaos` runs ten thousand calls for each scene."""

from __future__ import annotations

import pytest

from ..support.plc_calls import Calls
from . import chaos, chaos_ends


@pytest.mark.sample("[plc_serves-", "[python_goals-", "[plc_goals-")
@pytest.mark.parametrize(
    ("scene", "seconds"),
    [
        *(("python_alone", 3.0), ("plc_serves", 10.0), ("plc_asks", 5.0), ("plc_alone", 5.0)),
        *(("python_goals", 3.0), ("plc_serves_goals", 10.0), ("plc_sends_goals", 5.0), ("plc_goals", 5.0)),
    ],
)
def test_every_call_ends_and_gets_only_its_own_response(
    compiled_calls: Calls, monkeypatch: pytest.MonkeyPatch, scene: str, seconds: float
) -> None:
    """Allow calls to end late, because other tests share the processors."""
    monkeypatch.setattr(chaos_ends, "SLACK", 10.0)
    replies = kills = 0
    for seed in range(1, 9):  # one seed is enough, but on a busy machine most calls time out
        verdict = chaos.run(compiled_calls.folder, scene, 10_000, seed=seed, longest=seconds)
        assert not verdict.errors, verdict
        replies, kills = replies + verdict.ends["r"], kills + verdict.kills.total()
        if replies > 20 and kills >= 2:
            break
    assert replies > 20, verdict
    assert kills >= 2, verdict


@pytest.mark.parametrize(
    ("scene", "fault", "expected"),
    [
        ("python_alone", "python_client", "got the answer to another"),
        ("python_alone", "python_server", "was there before the server that served it"),
        ("python_goals", "python_numbers", "got the answer to another"),
        ("plc_asks", "any_reply", "got the answer to another"),
    ],
)
@pytest.mark.family("[plc_asks")
def test_planted_fault_is_detected(compiled_calls: Calls, scene: str, fault: str, expected: str) -> None:
    """Leave out a PLC that answers old calls, because tests/plc/test_services.py detects this fault faster."""
    verdict = chaos.run(compiled_calls.folder, scene, 10**6, seed=1, fault=fault, longest=120.0)
    assert any(expected in error for error in verdict.errors), verdict
