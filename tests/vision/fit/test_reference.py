"""Every element and zone against many-digit minima of sets drawn at random: 0.1 um and 0.1 urad."""

from __future__ import annotations

import pytest

from tests.vision.fit.campaign import LEAST, ZONES, run


@pytest.mark.parametrize("kind", [*LEAST, *ZONES])
def test_answers_are_the_reference_minima(kind: str) -> None:
    tally = run(kind, 2, 20)
    assert tally.sets == 2
    assert tally.good, tally
