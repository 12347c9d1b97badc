"""One thread from a close-up: sizes off every grid, accuracy against its own covariance, wrong threads noticed."""

import numpy as np
import pytest

from cellctl.vision.part import Refused, Thread
from cellctl.vision.thread import ThreadResult, fit_thread

from .thread_scene import Bolt, close_up

NOMINAL = Thread(8.0, 1.25)


def fit(bolt: Bolt, seed: int, nominal: Thread | None = NOMINAL, **view) -> ThreadResult:
    generator = np.random.default_rng(seed)
    points, eye = close_up(bolt, generator, **view)
    wild = generator.random(len(points)) < 0.02
    points[wild] += generator.normal(0, 2.0, (np.count_nonzero(wild), 3))
    return fit_thread(points, viewpoint=eye, nominal=nominal)


@pytest.mark.parametrize("elevation_deg", [15.0, 30.0, 45.0])
def test_radius_and_pitch_of_a_close_up_are_within_twice_the_bound(elevation_deg: float) -> None:
    """Bound for 20,000 points at sigma 0.03 mm: radius 1.9 um, pitch 0.10 um."""
    bolt = Bolt(radius=3.9471, pitch=1.2537)
    found = [fit(bolt, seed, elevation_deg=elevation_deg) for seed in range(8)]
    radius = np.array([result.thread.radius_mm - bolt.radius for result in found])
    pitch = np.array([result.thread.pitch_mm - bolt.pitch for result in found])
    assert np.sqrt(np.mean(radius**2)) < 2 * 0.0019
    assert np.sqrt(np.mean(pitch**2)) < 2 * 0.0001
    sigmas = np.array([[result.thread.sigma_radius_mm, result.thread.sigma_pitch_mm] for result in found])
    pull = np.stack([radius, pitch], axis=1) / sigmas
    assert 0.4 < np.sqrt(np.mean(pull**2)) < 1.6
    assert np.abs(pull).max() < 4.5


def test_the_axis_is_met() -> None:
    result = fit(Bolt(radius=3.9471, pitch=1.2537), 3)
    assert np.degrees(np.hypot(*result.direction[:2])) < 0.03
    at_face = result.point_mm - result.direction * result.point_mm[2] / result.direction[2]
    assert np.hypot(*at_face[:2]) < 0.01
    assert result.sigma_mm == pytest.approx(0.03, rel=0.1)


@pytest.mark.parametrize("bolt", [Bolt(hand=-1, pitch=1.2537), Bolt(starts=2, pitch=0.7519)])
def test_left_hand_and_two_starts_are_recognised(bolt: Bolt) -> None:
    thread = fit(bolt, 4, None).thread
    assert thread.hand == ("right" if bolt.hand > 0 else "left")
    assert thread.starts == bolt.starts
    assert thread.pitch_mm == pytest.approx(bolt.pitch, abs=0.001)


@pytest.mark.parametrize(
    "bolt",
    [
        Bolt(hand=-1, pitch=1.2537),
        Bolt(pitch=1.0),
        Bolt(pitch=1.5),
        Bolt(pitch=0.625, starts=2),
        Bolt(radius=3.6, pitch=1.25),
    ],
    ids=["left", "fine", "coarse", "two starts", "thin"],
)
def test_another_thread_is_refused(bolt: Bolt) -> None:
    with pytest.raises(Refused, match="thread_wrong"):
        fit(bolt, 5)


def test_a_plain_pin_is_no_thread() -> None:
    generator = np.random.default_rng(6)
    points, eye = close_up(Bolt(depth=0.0), generator, points=5000)
    with pytest.raises(Refused, match="thread_wrong"):
        fit_thread(points, viewpoint=eye, nominal=NOMINAL)


def test_too_few_points_are_refused() -> None:
    with pytest.raises(Refused, match="too_few_points"):
        fit_thread(np.zeros((50, 3)))
