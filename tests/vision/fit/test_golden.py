"""Reference sets whose minima were computed in many digits, without the code under test (`golden.py`)."""

from __future__ import annotations

import json
from typing import Any

import numpy as np
import pytest

from cellctl.vision import fit
from tests.vision.fit.golden import FILE

LIMIT_MM, LIMIT_RAD = 1e-6, 1e-9
"""A hundredth of what metrology institutes test, so that a loss of digits shows long before it counts."""
SETS: list[dict[str, Any]] = json.loads(FILE.read_text(encoding="utf-8"))


@pytest.mark.parametrize("kind", ["line", "plane", "circle", "sphere", "cylinder", "cone"])
def test_least_squares_meets_the_minimum(kind: str) -> None:
    sets = [one for one in SETS if one["kind"] == kind]
    assert len(sets) >= 12
    for one in sets:
        found = getattr(fit, kind)(np.array(one["points"]))
        assert found.point_mm == pytest.approx(np.array(one["point"]), abs=LIMIT_MM), one["family"]
        if "direction" in one:
            assert np.linalg.norm(np.cross(found.direction, one["direction"])) < LIMIT_RAD, one["family"]
        if "radius" in one:
            assert found.radius_mm == pytest.approx(one["radius"], abs=LIMIT_MM), one["family"]
        if "apex_rad" in one:
            assert np.radians(found.apex_angle_deg) == pytest.approx(one["apex_rad"], abs=LIMIT_RAD), one["family"]
            assert found.direction @ np.array(one["direction"]) > 0.0, one["family"]


@pytest.mark.parametrize("kind", ["plane", "circle", "cylinder"])
def test_minimum_zone_is_the_narrowest(kind: str) -> None:
    sets = [one for one in SETS if one["kind"] == kind and "zone" in one]
    assert len(sets) >= 8
    for one in sets:
        found = getattr(fit, f"{kind}_zone")(np.array(one["points"]))
        assert found.zone_mm == pytest.approx(one["zone"], abs=LIMIT_MM), one["family"]
