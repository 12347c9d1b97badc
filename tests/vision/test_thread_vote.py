"""The vote for a thread: what many points say counts, what few points cannot tell does not."""

from __future__ import annotations

import numpy as np
import pytest

from cellctl.vision.part import Refused, Thread
from cellctl.vision.thread_vote import ThreadVote, check_vote, vote

SINGLE = Thread(major_diameter_mm=6.0, pitch_mm=1.0)


def crests(seed: int, points: int, *, starts: int = 1, arc_rad: float = 0.9, studs: int = 4) -> ThreadVote:
    """The vote of points that crowd at the crests of `studs` threads of 10 mm, each seen over an arc of its own."""
    rng = np.random.default_rng(seed)
    stud = np.repeat(np.arange(studs), points)
    angle = rng.uniform(0.0, 2.0 * np.pi, studs)[stud] + rng.uniform(-arc_rad, arc_rad, len(stud))
    crest = (starts * angle / (2.0 * np.pi) + rng.uniform(0.0, 1.0, studs)[stud]) % 1.0
    height = 2.0 + rng.integers(0, 8, len(stud)) + crest + rng.normal(0.0, 0.13, len(stud))
    radius = 2.8 + 0.1 * np.cos(2.0 * np.pi * (height - crest)) + rng.normal(0.0, 0.05, len(stud))
    return vote(radius, angle, height, stud, studs, pitch_low_mm=0.45, pitch_high_mm=2.2, expected=SINGLE)


def test_few_points_on_a_narrow_arc_hardly_speak_against_the_expected_thread() -> None:
    told = [crests(seed, 15, arc_rad=0.6) for seed in range(200)]
    others = sum(1 for ballot in told if (ballot.starts, ballot.hand) != (1, "right"))
    assert others <= 6, f"{others} of 200, seeds 0 to 199"


def test_many_points_tell_two_starts_from_the_expected_one() -> None:
    for seed in range(50):
        with pytest.raises(Refused, match=r"2 start\(s\)"):
            check_vote(crests(seed, 600, starts=2), SINGLE)
