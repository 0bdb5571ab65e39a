"""Ten thousand calls while server and client are killed, or as many as 20 s have; and that planted faults are found."""

from __future__ import annotations

from collections import Counter

import pytest

from . import chaos


def test_every_call_ends_and_none_in_the_reply_of_another():
    ends, kills = Counter(), 0
    for seed in range(1, 6):  # one is enough where the machine has nothing else to do
        verdict = chaos.run(10_000, seed, longest=20.0)
        assert not verdict.complaints
        ends, kills = ends + verdict.ends, kills + verdict.kills
        if ends["r"] > 500 and all(ends[kind] for kind in "rft"):
            break
    print(ends, kills)
    assert kills > 20
    assert all(ends[kind] for kind in "rft")
    assert ends["r"] > 500


@pytest.mark.parametrize(("fault", "found"), [("client", "got the reply of another"), ("server", "was served after")])
def test_a_planted_fault_is_found(fault, found):
    for seed in range(1, 11):  # a rare instant each
        verdict = chaos.run(2_000, seed, fault, longest=5.0)
        if verdict.complaints:
            break
    assert found in verdict.complaints[0]
