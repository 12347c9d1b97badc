"""The whole alignment on exact parts: the commanded axes bring every hole onto its stud, in the cell's own sense."""

from dataclasses import replace

import numpy as np
import pytest

from cellctl.calibration import AxisLine, Stage
from cellctl.docking import align, align_spec
from cellctl.kinematics import AxesPosition, shaft_at
from cellctl.vision.part import Refused

from .parts import HEIGHT, calibration, measurement, pose, recipe

RECIPE = recipe()
CALIBRATION = calibration()
ANGLES = RECIPE.pattern.angles()
MIRRORED = RECIPE.part("rotor").angles_deg
SPEC = replace(align_spec(RECIPE), samples=512)


def tilted_calibration():
    """Axes that are neither square nor on the origin."""
    return CALIBRATION.model_copy(
        update={
            "table_axis": AxisLine(point_mm=(0.3, -0.2, 0.0), direction=(2e-4, -1e-4, 1.0)),
            "jack_line": AxisLine(direction=(-3e-4, 2e-4, 1.0)),
            "stage": Stage(x_direction=(1.0, 1e-3, 0.0), y_direction=(-2e-3, 1.0, 0.0)),
        }
    )


@pytest.mark.parametrize("cal", [CALIBRATION, tilted_calibration()], ids=["square", "tilted"])
def test_the_target_brings_every_hole_onto_its_stud(cal) -> None:
    generator = np.random.default_rng(5)
    for _ in range(25):
        rotor = measurement("stud", pose(*generator.normal(0, 1, 2), HEIGHT, generator.uniform(-5, 5), True), MIRRORED)
        start = pose(*generator.normal(0, 2, 2), 0.0, generator.uniform(-170, 170))
        measured_at = AxesPosition(*generator.normal(0, 3, 2), generator.uniform(0, 20), generator.uniform(-5, 5))
        shaft = measurement("hole", start, ANGLES)
        found = align(rotor, shaft, cal, measured_at, replace(SPEC, theta_low_deg=-200, theta_high_deg=200))
        moved = shaft_at(cal, start, measured_at, found.target)
        for hole, stud in zip(shaft.features, rotor.features, strict=True):
            local = np.linalg.inv(start) @ np.append(hole.center_mm, 1.0)
            error = (moved @ local)[:3] - stud.center_mm
            assert np.linalg.norm(error[:2]) < 0.012  # what the tilt of the axes leaves between root and tip
            assert -0.2 < error[2] <= 1e-6
        assert found.clearance_mm.min() > 0.135
        assert found.p_insert > 0.9


def test_the_table_turns_as_the_correction_says() -> None:
    shaft = measurement("hole", pose(turn_deg=3.0), ANGLES)
    rotor = measurement("stud", pose(z=HEIGHT, down=True), MIRRORED)
    found = align(rotor, shaft, CALIBRATION, AxesPosition(0, 0, 0, 0), SPEC)
    assert found.theta_deg == pytest.approx(-3.0, abs=1e-6)
    assert found.target.z_mm == pytest.approx(HEIGHT, abs=1e-6)
    assert found.approach_z_mm == pytest.approx(HEIGHT - 32.0 - 3.0, abs=1e-6)
    assert found.gap_mm == pytest.approx(HEIGHT, abs=1e-9)


def test_an_index_fixes_the_pitch_and_without_one_the_nearest_is_taken() -> None:
    rotor = measurement("stud", pose(z=HEIGHT, down=True), MIRRORED)
    indexed = align(
        rotor, measurement("hole", pose(turn_deg=47.0), ANGLES), CALIBRATION, AxesPosition(0, 0, 0, 0), SPEC
    )
    assert indexed.theta_deg == pytest.approx(-47.0, abs=1e-6)
    assert not indexed.clocking_free
    free = measurement("hole", pose(turn_deg=47.0), ANGLES, clocking_free=True)
    found = align(rotor, free, CALIBRATION, AxesPosition(0, 0, 0, 0), SPEC)
    assert found.theta_deg == pytest.approx(3.0, abs=1e-6)
    assert found.clocking_free
    assert found.partner[0] == 5


def test_the_heated_shaft_uses_up_clearance_and_the_window_says_how_far() -> None:
    rotor = measurement("stud", pose(z=HEIGHT, down=True), MIRRORED)
    found = align(rotor, measurement("hole", pose(), ANGLES), CALIBRATION, AxesPosition(0, 0, 0, 0), SPEC)
    assert found.clearance_hot_mm == pytest.approx(0.15 - 120 * 12.5e-6 * 45, abs=1e-4)
    assert found.window.low_k == pytest.approx((0.06 + 0.005 + 0.02) / (12.5e-6 * 180))
    assert found.window.low_k < 45 < found.window.high_k < 100


def test_too_much_scatter_leaves_no_window_and_says_why() -> None:
    generator = np.random.default_rng(6)
    rotor = measurement("stud", pose(z=HEIGHT, down=True), MIRRORED, errors=generator.normal(0, 0.04, (36, 2)))
    found = align(rotor, measurement("hole", pose(), ANGLES), CALIBRATION, AxesPosition(0, 0, 0, 0), SPEC)
    assert not found.window.exists
    assert "bolt" in found.window.reason


def test_missing_features_and_other_frames_are_refused() -> None:
    rotor = measurement("stud", pose(z=HEIGHT, down=True), MIRRORED)
    shaft = measurement("hole", pose(), ANGLES)
    features = (replace(shaft.features[0], found=False, center_mm=None), *shaft.features[1:])
    with pytest.raises(Refused, match="features_missing"):
        align(rotor, replace(shaft, features=features), CALIBRATION, AxesPosition(0, 0, 0, 0), SPEC)
    with pytest.raises(Refused, match="frames_disagree"):
        align(replace(rotor, frame="input"), shaft, CALIBRATION, AxesPosition(0, 0, 0, 0), SPEC)
    with pytest.raises(Refused, match="out_of_range"):
        turned = measurement("hole", pose(turn_deg=90.0), ANGLES)
        align(rotor, turned, CALIBRATION, AxesPosition(0, 0, 0, 0), replace(SPEC, theta_low_deg=-20, theta_high_deg=20))


def test_same_input_same_bits() -> None:
    generator = np.random.default_rng(7)
    rotor = measurement("stud", pose(z=HEIGHT, down=True), MIRRORED, errors=generator.normal(0, 0.03, (36, 2)))
    shaft = measurement("hole", pose(turn_deg=1.0), ANGLES)
    tight = replace(SPEC, clearance_mm=0.1)
    first, second = (align(rotor, shaft, CALIBRATION, AxesPosition(0, 0, 0, 0), tight) for _ in range(2))
    assert first.p_insert == second.p_insert < 1.0
    assert first.target == second.target
