"""Ten thousand calls while server and client are killed, or as many as 20 s have; and that planted faults are found."""

from __future__ import annotations

import pytest

from . import chaos


def test_every_call_ends_and_none_in_the_reply_of_another():
    verdict = chaos.run(10_000, seed=1, longest=20.0)
    print(verdict.ends, verdict.kills)
    assert not verdict.complaints
    assert verdict.kills > 20
    assert all(verdict.ends[kind] for kind in "rft")
    assert verdict.ends["r"] > 500


@pytest.mark.parametrize(("fault", "found"), [("client", "got the reply of another"), ("server", "was served after")])
def test_a_planted_fault_is_found(fault, found):
    for seed in range(1, 11):  # a rare instant each
        verdict = chaos.run(2_000, seed, fault, longest=5.0)
        if verdict.complaints:
            break
    assert found in verdict.complaints[0]
