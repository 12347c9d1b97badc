"""The rest of a run, from its dry run."""

from __future__ import annotations

import pytest

from cellctl.time_left import time_left_s

PHASES = (("scan", 20.0), ("align", 40.0), ("heat", 600.0))


@pytest.mark.parametrize(
    ("phase", "fraction", "left"),
    [("scan", 0.0, 660.0), ("align", 0.5, 620.0), ("heat", 1.0, 0.0), ("heat", 7.0, 0.0), ("", 0.0, None)],
)
def test_the_rest_of_the_phase_and_all_later_ones(phase: str, fraction: float, left: float | None) -> None:
    assert time_left_s(PHASES, phase, fraction) == left
