"""Studs of the twin's own pictures against its truth: correlated noise, ripple, scale, outliers, stray light."""

import numpy as np
import pytest

from cellctl.vision.part import FaceFit, FeatureFit, Part, Thread
from cellctl.vision.studs import measure_studs
from hal.fake.scene.camera import ScanErrors, camera_for
from hal.fake.scene.render import SceneState, render
from hal.fake.scene.shapes import PartShape, Studs
from hal.fake.scene.thread_form import StudForm

COUNT = 36
PART = Part(
    "stud",
    240.0,
    tuple(-360.0 * i / COUNT for i in range(COUNT)),
    diameter_mm=(8.0,) * COUNT,
    length_mm=32.0,
    thread=Thread(8.0, 1.0),
)


def measured(seed: int, points: int, errors: ScanErrors) -> tuple[np.ndarray, np.ndarray, tuple[FeatureFit, ...]]:
    """Errors (n, 2) of the found studs in the part frame in mm, the same over one sigma, and the features."""
    generator = np.random.default_rng(seed)
    angles = np.radians(PART.angles_deg)
    centres = 120.0 * np.column_stack([np.cos(angles), np.sin(angles)]) + generator.normal(0, 0.01, (COUNT, 2))
    axes = np.column_stack([generator.normal(0, np.radians(0.02), (COUNT, 2)), np.ones(COUNT)])
    studs = Studs(
        centres, axes / np.linalg.norm(axes, axis=1, keepdims=True), generator.random(COUNT), StudForm(3.9863)
    )
    turn = np.radians(generator.uniform(-4, 4))
    pose = np.eye(4)
    c, s = np.cos(turn), np.sin(turn)
    pose[:3, :3] = np.diag([1.0, -1.0, -1.0]) @ np.array([[c, -s, 0], [s, c, 0], [0, 0, 1.0]])
    pose[:3, 3] = *generator.normal(0, 1, 2), 350.0
    shape = PartShape(rings_mm=((90.0, 140.0, 0.0),), studs=studs)
    scene = SceneState(np.eye(4), ((pose, shape),), camera=camera_for(points), errors=errors)
    face = FaceFit(pose[:3, 3], pose[:3, 2], pose[:3, :2].T, np.eye(3) * 1e-12, errors.noise_mm, 0.01, 1000, 1.0)
    features = measure_studs(render(scene, seed), face, PART)
    offsets, pulls = [], []
    for feature in features:
        if feature.center_mm is None:
            continue
        place = (pose[:3, :3].T @ (feature.center_mm - pose[:3, 3]))[:2]
        offset = place - centres[np.argmin(np.hypot(*(centres - place).T))]
        covariance = pose[:3, :3].T @ feature.covariance_mm2 @ pose[:3, :3]
        offsets.append(offset)
        pulls.append(offset / np.sqrt(np.diag(covariance)[:2]))
    return np.array(offsets), np.array(pulls), features


@pytest.mark.parametrize(
    ("points", "limit_mm"),
    [(100_000, 2 * 0.0166), (300_000, 2 * 0.0090), (1_000_000, 2 * 0.0047)],
)
def test_white_noise_within_twice_the_bound(points: int, limit_mm: float) -> None:
    found = [measured(seed, points, ScanErrors(correlation_px=0.0, ripple_mm=0.0, scale=0.0)) for seed in range(2)]
    offsets = np.concatenate([offset for offset, _, _ in found])
    assert len(offsets) == 2 * COUNT
    assert np.sqrt(np.mean(offsets**2)) < limit_mm
    assert 0.7 < np.sqrt(np.mean(np.concatenate([pull for _, pull, _ in found]) ** 2)) < 1.3


def test_a_nominal_scan_is_measured_with_an_honest_sigma() -> None:
    found = [measured(seed, 300_000, ScanErrors()) for seed in range(3)]
    offsets = np.concatenate([offset for offset, _, _ in found])
    assert len(offsets) == 3 * COUNT
    assert np.sqrt(np.mean(offsets**2)) < 0.018
    assert 0.7 < np.sqrt(np.mean(np.concatenate([pull for _, pull, _ in found]) ** 2)) < 1.5


def test_with_a_hundredth_of_the_noise_a_hundredth_of_the_error_is_left() -> None:
    quiet = ScanErrors(0.0003, correlation_px=0.0, ripple_mm=0.0, scale=0.0, outliers=0.0, flying=0.0, bands=0)
    offsets, _, features = measured(7, 300_000, quiet)
    assert np.sqrt(np.mean(offsets**2)) < 2e-4
    assert features[0].thread is not None
    assert features[0].thread.pitch_mm == pytest.approx(1.0, abs=1e-5)
    assert features[0].thread.radius_mm == pytest.approx(3.9863, abs=1e-4)


def test_same_picture_same_bits() -> None:
    first, second = (measured(3, 100_000, ScanErrors())[0] for _ in range(2))
    assert (first == second).all()
