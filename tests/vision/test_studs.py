"""Studs of a flange scan: positions against the truth, wrong threads, missing studs."""

from dataclasses import replace

import numpy as np
import pytest

from cellctl.vision.part import FaceFit, Part, Refused, Thread
from cellctl.vision.studs import measure_studs

from .thread_scene import Bolt, flange

PART = Part(
    "stud",
    200.0,
    tuple(30.0 * i for i in range(12)),
    diameter_mm=(8.0,) * 12,
    length_mm=32.0,
    thread=Thread(8.0, 1.0),
)
FACE = FaceFit(
    np.array([0.0, 0.0, 350.0]),
    np.array([0.0, 0.0, -1.0]),
    np.array([[1.0, 0.0, 0.0], [0.0, -1.0, 0.0]]),
    np.eye(3) * 1e-12,
    0.03,
    0.01,
    10000,
    1.0,
)


def places(generator: np.random.Generator, turn_deg: float = 2.3) -> np.ndarray:
    angles = np.radians(np.array(PART.angles_deg) + turn_deg)
    return 100.0 * np.stack([np.cos(angles), np.sin(angles)], axis=1) + generator.normal(0, 0.02, (12, 2)) + [0.7, -0.4]


def bolts(generator: np.random.Generator, **sizes) -> list[Bolt]:
    return [Bolt(phase=p, **sizes) for p in generator.random(12)]


def errors_of(features, truth: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    centres = np.array([feature.center_mm[:2] * [1, -1] for feature in features])
    sigmas = np.array([np.sqrt(np.diag(feature.covariance_mm2)[:2]) for feature in features])
    return centres - truth, sigmas


def test_every_stud_is_found_where_it_is() -> None:
    errors, sigmas = [], []
    for seed in range(4):
        generator = np.random.default_rng(seed)
        truth = places(generator)
        features = measure_studs(flange(bolts(generator), truth, generator), FACE, PART)
        assert all(feature.found for feature in features)
        assert [feature.index for feature in features] == list(range(12))
        error, sigma = errors_of(features, truth)
        errors.append(error)
        sigmas.append(sigma)
        thread = features[0].thread
        assert thread is not None and thread.hand == "right" and thread.starts == 1
        assert thread.pitch_mm == pytest.approx(1.0037, abs=4 * thread.sigma_pitch_mm)
        assert thread.sigma_pitch_mm < 2e-4
    rms = float(np.sqrt(np.mean(np.square(errors))))
    assert rms < 0.015
    assert 0.5 < rms / float(np.sqrt(np.mean(np.square(sigmas)))) < 1.3


def test_a_missing_stud_is_reported_and_none_is_invented() -> None:
    generator = np.random.default_rng(20)
    truth = places(generator)
    keep = [i for i in range(12) if i not in (3, 8)]
    made = bolts(generator)
    cloud = flange([made[i] for i in keep], truth[keep], generator)
    features = measure_studs(cloud, FACE, PART)
    missing = [feature for feature in features if not feature.found]
    assert len(missing) == 2
    assert all(feature.center_mm is None and feature.reason for feature in missing)
    assert missing[1].index - missing[0].index == 5


def test_the_given_pose_numbers_the_studs() -> None:
    generator = np.random.default_rng(21)
    truth = places(generator, turn_deg=60.0)
    cloud = flange(bolts(generator), truth, generator)
    c, s = np.cos(np.radians(60.0)), np.sin(np.radians(60.0))
    pose = np.eye(4)
    pose[:3, :3] = np.diag([1.0, -1.0, -1.0]) @ np.array([[c, -s, 0], [s, c, 0], [0, 0, 1.0]])
    pose[:3, 3] = 0.7, 0.4, 350.0
    error, _ = errors_of(measure_studs(cloud, FACE, PART, pose), truth)
    assert np.abs(error).max() < 0.06


@pytest.mark.parametrize("sizes", [{"hand": -1}, {"pitch": 1.25}, {"pitch": 0.75}, {"pitch": 0.5, "starts": 2}])
def test_a_wrong_thread_is_refused(sizes) -> None:
    generator = np.random.default_rng(22)
    truth = places(generator)
    with pytest.raises(Refused, match="thread_wrong"):
        measure_studs(flange(bolts(generator, **sizes), truth, generator), FACE, PART)


@pytest.mark.parametrize("sizes", [{"hand": -1}, {"pitch": 1.25}, {"pitch": 0.75}])
def test_one_stud_with_another_thread_is_refused_by_name(sizes) -> None:
    generator = np.random.default_rng(24)
    truth, made = places(generator), bolts(generator)
    made[4] = Bolt(phase=0.2, **sizes)
    with pytest.raises(Refused, match="thread_wrong: stud 4"):
        measure_studs(flange(made, truth, generator), FACE, PART)


@pytest.mark.parametrize("sizes", [{"radius": 3.5}, {"depth": 0.0}], ids=["thin", "no thread"])
def test_one_stud_that_does_not_fit_is_reported(sizes) -> None:
    generator = np.random.default_rng(25)
    truth, made = places(generator), bolts(generator)
    made[4] = Bolt(phase=0.2, **sizes)
    features = measure_studs(flange(made, truth, generator), FACE, PART)
    assert [feature.index for feature in features if not feature.found] == [4]
    assert "fit a stud" in features[4].reason


def test_a_left_hand_thread_that_is_asked_for_is_measured() -> None:
    generator = np.random.default_rng(23)
    truth = places(generator)
    part = replace(PART, thread=Thread(8.0, 1.0, "left"))
    features = measure_studs(flange(bolts(generator, hand=-1), truth, generator), FACE, part)
    assert all(feature.found and feature.thread.hand == "left" for feature in features)


def test_a_bare_face_is_refused() -> None:
    cloud = np.full((100, 100, 3), np.nan, dtype=np.float32)
    with pytest.raises(Refused, match="features_missing"):
        measure_studs(cloud, FACE, PART)
