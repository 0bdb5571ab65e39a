"""Tests of the ticks beside the curves of `shmgen view`: they are round, few, and never -0.00."""

from __future__ import annotations

import pytest

pytest.importorskip("textual_plotext", exc_type=Exception)

from shmgen.view.curves import round_ticks


@pytest.mark.parametrize(
    ("minimum", "maximum", "expected"),
    [
        (-1.0, 0.99, "-1 -0.5 0 0.5"),
        (-0.9999, 1.0, "-0.5 0 0.5 1"),
        (175.0, 185.0, "176 178 180 182 184"),
        (1e6, 1e6 + 0.5, "1000000 1000000.1 1000000.2 1000000.3 1000000.4 1000000.5"),
        (0.25, 0.25, ""),
        (-1e308, 1e308, ""),
    ],
)
def test_ticks_are_round_and_few(minimum: float, maximum: float, expected: str) -> None:
    assert " ".join(f"{tick:.10g}" for tick in round_ticks(minimum, maximum)) == expected
