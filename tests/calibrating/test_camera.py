"""A view's pose from spheres: exact without noise, honest with it, refused where the spheres say too little."""

from __future__ import annotations

import numpy as np
import pytest

from cellctl.calibrating.camera import require_millimetres, view_pose
from cellctl.calibration import Scale, load_calibration
from cellctl.kinematics import rotation_about
from cellctl.studies.calibration import nees
from cellctl.vision.geometry import Array, inverse, transform
from cellctl.vision.part import Refused
from cellctl.vision.spheres import SphereFit
from tests.journeys.twin_runs import ROOT

FILE = load_calibration(ROOT / "deploy" / "calibration.fake.toml")
CERTIFIED = np.array(FILE.artefact.rotor_side_mm)
START = FILE.views["rotor"].matrix
DEEP = np.diag([2e-5, 2e-5, 1e-5])
QUIET = Scale()


def off_by(turn_deg: Array, shift_mm: Array) -> Array:
    """A pose that is that far from where it is believed to be."""
    pose = START.copy()
    angle = float(np.linalg.norm(turn_deg))
    if angle > 0.0:
        pose[:3, :3] = rotation_about(turn_deg / angle, np.radians(angle)) @ pose[:3, :3]
    pose[:3, 3] += shift_mm
    return pose


def looks_at(true: Array, generator: np.random.Generator | None, looks: int = 4, centres: Array = CERTIFIED):
    """Fits of the spheres from `true`, with noise of `DEEP` for each centre."""
    seen = transform(inverse(true), centres)
    noise = np.linalg.cholesky(DEEP)
    return [
        [SphereFit(c + (noise @ generator.normal(size=3) if generator else 0.0), DEEP / 9e-4, 0.03) for c in seen]
        for _ in range(looks)
    ]


def found_from(looks, centres: Array = CERTIFIED, scale: Scale = QUIET):
    return view_pose(looks, centres, START, scale, sphere_diameter_mm=20.0)


def error_of(pose: Array, true: Array) -> Array:
    turn = pose[:3, :3] @ true[:3, :3].T
    vector = 0.5 * np.array([turn[2, 1] - turn[1, 2], turn[0, 2] - turn[2, 0], turn[1, 0] - turn[0, 1]])
    return np.array([*np.degrees(vector), *(pose[:3, 3] - true[:3, 3])])


def test_without_noise_the_pose_is_exact() -> None:
    true = off_by(np.array([0.3, -0.2, 0.5]), np.array([1.0, -2.0, 0.5]))
    found = found_from(looks_at(true, None))
    np.testing.assert_allclose(found.T_cell_scanner, true, atol=1e-9)
    assert found.residual_mm.max() < 1e-9


def test_errors_are_as_large_as_stated() -> None:
    errors, covariances = [], []
    for seed in range(100):
        generator = np.random.default_rng(seed)
        true = off_by(generator.normal(0.0, 0.1, 3), generator.normal(0.0, 0.3, 3))
        found = found_from(looks_at(true, generator))
        errors.append(error_of(found.T_cell_scanner, true))
        covariances.append(found.covariance)
    assert np.mean(nees(np.array(errors), np.array(covariances))) == pytest.approx(1.0, abs=0.2)


def test_what_repetition_does_not_show_is_in_the_covariance() -> None:
    looks = looks_at(START, None)
    ripple = found_from(looks, scale=Scale(sigma_ripple_mm=0.01))
    stretch = found_from(looks, scale=Scale(sigma_scale=5e-5))
    assert 0.001 < ripple.sigma_rotation_deg < 0.003
    assert np.sqrt(stretch.covariance[5, 5]) == pytest.approx(5e-5 * 332.5, rel=0.05)


@pytest.mark.parametrize(
    ("looks", "centres", "code"),
    [
        (looks_at(START, None, 2), CERTIFIED, "geometry_too_weak"),
        (looks_at(START, None, 4, CERTIFIED[:3]), CERTIFIED[:3], "geometry_too_weak"),
        (looks_at(START, None, 4, 1.01 * CERTIFIED), CERTIFIED, "wrong_unit"),
        (looks_at(START, None, 4, CERTIFIED + np.eye(4, 3) * 0.5), CERTIFIED, "residual_too_large"),
    ],
)
def test_refusals(looks, centres: Array, code: str) -> None:
    with pytest.raises(Refused) as refused:
        found_from(looks, centres)
    assert refused.value.code == code


def test_spheres_in_a_row_do_not_fix_a_view() -> None:
    row = np.array([[x, 0.001 * x * x, 380.0] for x in (-135.0, -45.0, 45.0, 135.0)])
    with pytest.raises(Refused, match="geometry_too_weak"):
        found_from(looks_at(START, np.random.default_rng(1), 4, row), row, Scale(sigma_ripple_mm=0.01))


def test_a_scan_in_metres_is_told() -> None:
    with pytest.raises(Refused, match="wrong_unit"):
        require_millimetres(np.full((4, 4, 3), 0.35, dtype=np.float32))
    with pytest.raises(Refused, match="wrong_unit"):
        require_millimetres(np.full((4, 4, 3), np.nan, dtype=np.float32))
