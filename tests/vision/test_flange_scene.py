"""Emulated flange scans with the artefacts of real ones: what is found, how well, and that no pose is a wrong one."""

from __future__ import annotations

from dataclasses import replace
from functools import cache

import numpy as np

from cellctl.vision.geometry import inverse, transform
from tests.vision.flange_campaign import PART, Outcome, outcome, scene, summary
from tests.vision.flange_scene import CENTRES, Flange, Scan, random_pose, render

SLOTS = ((90.0, 25.0), (180.0, 25.0), (270.0, 25.0))


@cache
def plain(slots: bool) -> tuple[Scan, np.ndarray]:
    """A scan with all artefacts of middling size, and its cloud in the part's frame."""
    rng = np.random.default_rng(11)
    scan = Scan(
        random_pose(rng, tilt_deg=15.0),
        Flange(slots=SLOTS if slots else ()),
        lost=0.0,
        behind=False,
        half_field_mm=34.0,
    )
    return scan, transform(inverse(scan.T_scanner_part), render(scan, rng).astype(np.float64))


def cut(slots: bool, *disks: tuple[float, float, float]) -> Outcome:
    """What comes of the plain scan without the points in disks (x, y, radius) of the part's frame."""
    scan, local = plain(slots)
    for x, y, radius in disks:
        local = local[np.hypot(local[:, 0] - x, local[:, 1] - y) > radius]
    return outcome(scan, transform(scan.T_scanner_part, local).astype(np.float32))


def test_random_scans() -> None:
    outcomes = [scene(7, number) for number in range(8)]
    result = summary(outcomes)
    assert result["wrong"] == 0
    assert result["all holes found"] >= 6
    assert result["clocking deg"]["median"] < 0.15 and result["clocking deg"]["max"] < 0.25
    assert result["circle diameter mm"]["median"] < 0.1
    assert result["hole to nominal rms mm"]["median"] < 0.2


def test_a_torn_hole_turns_nothing() -> None:
    """Half of one hole's rim is gone: the circle that is left of it lies where the others say."""
    x, y = 1.12 * CENTRES[2]
    whole, torn = cut(False), cut(False, (x, y, 3.5))
    assert whole.found == torn.found == 5
    assert abs(torn.clocking_deg - whole.clocking_deg) < 0.15
    assert torn.nominal_rms_mm < 0.2


def test_the_key_hole_is_known_by_exclusion_where_the_face_is_closed_at_its_other_places() -> None:
    result = cut(False, (25.0, 0.0, 6.0))
    assert result.found == 4 and abs(result.clocking_deg) < 0.3


def test_without_the_key_hole_a_slotted_flange_is_refused() -> None:
    """Three more places of the key hole are slots: four tapped holes look alike from all sides."""
    assert cut(True).found == 5
    assert cut(True, (25.0, 0.0, 6.0)).code == "pattern_ambiguous"


def test_a_void_of_the_key_holes_size_in_another_of_its_places() -> None:
    """As round as a hole and right in place: two key holes are one too many, but never the wrong one."""
    assert not cut(False, (0.0, 25.0, 3.0)).wrong
    torn = cut(False, (0.0, 24.4, 2.6), (0.8, 25.9, 1.6))
    assert not torn.wrong and torn.found == 5


def test_the_part_is_the_recipes() -> None:
    assert np.allclose(np.hypot(*CENTRES.T), 0.5 * PART.circle_diameter_mm)
    assert replace(PART).count == len(CENTRES)
