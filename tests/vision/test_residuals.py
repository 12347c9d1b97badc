"""Residuals of single points: noise and nothing else on every surface, and no surface for what is none."""

from __future__ import annotations

from dataclasses import replace
from functools import cache

import numpy as np
import pytest

from cellctl.vision.geometry import Array, pose, tangents
from cellctl.vision.measure import measure_part
from cellctl.vision.part import Part, PartMeasurement, Thread
from cellctl.vision.residuals import CHAMFER, FACE, NONE, THREAD, WALL, Residuals, residuals
from cellctl.vision.studs import measure_studs
from tests.vision.parts import FLANGE, SHAFT
from tests.vision.synthetic import View, pose_above, render, true_centres
from tests.vision.test_studs import FACE as STUD_FACE
from tests.vision.test_studs import PART as STUDS
from tests.vision.thread_scene import Bolt, flange

SIGMA = 0.02


@cache
def seen(part: Part, sigma_mm: float = SIGMA) -> tuple[View, Array, PartMeasurement, Residuals]:
    """A view of `part` with feature 3 missing, its valid points, what was measured, and the residuals."""
    turned = pose_above(350.0, tilt=(0.03, -0.02), turn=0.05, shift=(2.0, -1.0))
    view = View(part, turned, pixels=600, sigma_mm=sigma_mm, missing=(3,))
    grid = render(view, np.random.default_rng(11))
    points = grid[np.isfinite(grid[..., 0])].astype(np.float64)
    measured = measure_part(grid, part)
    return view, points, measured, residuals(points, measured, part)


def incidence(view: View, points: Array, found: Residuals) -> Array:
    """Cosine (N,) between ray and the normal of the surface that each point was taken for: noise is along the ray."""
    part, T = view.part, view.T_scanner_part
    rays = points / np.linalg.norm(points, axis=1)[:, None] @ T[:3, :3]
    local = (points - T[:3, 3]) @ T[:3, :3]
    centres = true_centres(view)[:, :2]
    offset = local[:, :2] - centres[np.maximum(found.feature, 0)]
    inward = (offset * rays[:, :2]).sum(axis=1) / np.maximum(np.hypot(*offset.T), 1e-9)
    slope = np.tan(np.radians(part.chamfer_angle_deg or 45.0))
    cone = (inward - slope * rays[:, 2]) / np.hypot(1.0, slope)
    normal = {FACE: rays[:, 2], CHAMFER: cone, WALL: inward}
    return np.abs(np.select([found.surface == kind for kind in normal], list(normal.values()), 1.0))


@pytest.mark.parametrize("part", [SHAFT, FLANGE], ids=["36 holes", "7 holes"])
def test_residuals_are_the_noise_of_the_scanner(part: Part) -> None:
    view, points, _, found = seen(part)
    cosine = incidence(view, points, found)
    # a wall is seen so much at a slant that the error of the hole's centre is no longer small beside the noise
    for kind, most in ((FACE, 1.1), (CHAMFER, 1.1), (WALL, 1.3)):
        mine = found.surface == kind
        ratio = found.distance_mm[mine] / (SIGMA * cosine[mine])
        assert mine.sum() > 300
        assert 0.9 < np.sqrt(np.mean(ratio**2)) < most, kind
        assert abs(ratio.mean()) < 0.1, kind


@pytest.mark.parametrize("part", [SHAFT, FLANGE], ids=["36 holes", "7 holes"])
def test_points_go_to_the_surface_they_were_cast_on(part: Part) -> None:
    """With little noise the place alone tells the surface."""
    view = View(part, pose_above(350.0, turn=0.05), pixels=500, sigma_mm=0.01, outliers=0.0, lost=0.0, clutter=False)
    grid = render(view, np.random.default_rng(0))
    points = grid[np.isfinite(grid[..., 0])].astype(np.float64)
    found = residuals(points, measure_part(grid, part), part)
    local = (points - view.T_scanner_part[:3, 3]) @ view.T_scanner_part[:3, :3]
    rho, height = np.hypot(*local[:, :2].T), local[:, 2]
    slope = np.tan(np.radians(part.chamfer_angle_deg or 45.0))
    walls = np.asarray(part.diameter_mm)[np.maximum(found.feature, 0)]
    bottom = -0.5 * ((part.chamfer_diameter_mm or 0.0) - walls) / slope
    in_hole = (found.feature >= 0) & (height < -0.05)
    flat = (np.abs(height) < 0.03) & (rho > 0.5 * (part.face_inner_diameter_mm or 0.0))
    flat &= rho < 0.5 * (part.face_outer_diameter_mm or 0.0)
    assert np.mean(found.surface[flat & (found.feature < 0)] == FACE) > 0.999
    deep = in_hole & (height < bottom - 0.3) & (height > -(part.depth_mm or 0.0) + 0.1)
    assert deep.sum() > 300 and np.mean(found.surface[deep] == WALL) > 0.99
    upper = in_hole & (height > bottom + 0.3)
    assert upper.sum() > 100 and np.mean(found.surface[upper] == CHAMFER) > 0.97


def test_clutter_outliers_and_a_closed_place_lie_on_no_hole() -> None:
    view, points, _, found = seen(SHAFT)
    local = (points - view.T_scanner_part[:3, 3]) @ view.T_scanner_part[:3, :3]
    assert np.all(found.surface[np.abs(local[:, 2]) > 20.0] == NONE)
    assert np.isnan(found.distance_mm[np.abs(local[:, 2]) > 20.0]).all()
    assert not np.isin(found.surface[found.feature == 3], (CHAMFER, WALL)).any()
    assert np.all(np.abs(found.distance_mm[np.isfinite(found.distance_mm)]) <= found.reach_mm)


def test_proud_is_positive() -> None:
    _, points, measured, _ = seen(SHAFT)
    normal = measured.face.normal
    raised, sunk = (residuals(points + height * normal, measured, SHAFT) for height in (0.03, -0.03))
    for kind, sign in ((FACE, 1.0), (CHAMFER, 0.7)):
        assert np.median(raised.distance_mm[raised.surface == kind]) == pytest.approx(0.03 * sign, abs=0.006)
        assert np.median(sunk.distance_mm[sunk.surface == kind]) == pytest.approx(-0.03 * sign, abs=0.006)


def test_the_frame_of_the_measurement_does_not_matter() -> None:
    view, points, _, found = seen(SHAFT)
    grid = render(view, np.random.default_rng(11))
    T_cell_scanner = pose(np.array([[0.0, 0.0, 1.0], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0]]), np.array([5.0, -7.0, 300.0]))
    measured = measure_part(grid, SHAFT, T_cell_scanner)
    in_cell = residuals(points, measured, SHAFT, T_cell_scanner)
    assert np.mean(in_cell.surface == found.surface) > 0.9999
    both = np.isfinite(in_cell.distance_mm) & np.isfinite(found.distance_mm)
    assert np.abs(in_cell.distance_mm[both] - found.distance_mm[both]).max() < 1e-3


def stud_scene(hand: int) -> tuple[Array, PartMeasurement, Part]:
    """Twelve studs of unlike phases whose pattern is clocked by 25 degrees, as measured."""
    rng = np.random.default_rng(4)
    part = replace(STUDS, thread=Thread(8.0, 1.0, "right" if hand > 0 else "left"))
    angles = np.radians(np.array(part.angles_deg) + 25.0)
    places = 100.0 * np.column_stack([np.cos(angles), np.sin(angles)])
    grid = flange([Bolt(phase=p, hand=hand) for p in rng.random(12)], places, rng, sigma=SIGMA)
    across = tangents(STUD_FACE.normal)
    c, s = np.cos(np.radians(25.0)), np.sin(np.radians(25.0))
    rotation = np.column_stack([c * across[0] + s * across[1], c * across[1] - s * across[0], STUD_FACE.normal])
    T = pose(rotation, STUD_FACE.point_mm)
    features = measure_studs(grid, STUD_FACE, part, T, viewpoint=np.zeros(3))
    measured = PartMeasurement("input", "stud", STUD_FACE, T, np.eye(6), 0.0, True, features, 200.0)
    return grid[np.isfinite(grid[..., 0])].astype(np.float64), measured, part


@pytest.mark.parametrize("hand", [1, -1], ids=["right", "left"])
def test_threads_are_followed_turn_by_turn(hand: int) -> None:
    points, measured, part = stud_scene(hand)
    assert measured.found == 12
    found = residuals(points, measured, part)
    side = (found.local_mm[:, 2] > 2.0) & (found.local_mm[:, 2] < 30.0) & (found.feature >= 0)
    on = found.surface == THREAD
    assert side.sum() > 1000 and np.mean(on[side]) > 0.9
    assert 0.4 * SIGMA < found.distance_mm[on].std() < 1.15 * SIGMA
    assert abs(found.distance_mm[on].mean()) < 0.3 * SIGMA
    half_turn = [
        replace(f, thread=replace(f.thread, phase_rad=f.thread.phase_rad + np.pi)) if f.thread else f
        for f in measured.features
    ]
    off = residuals(points, replace(measured, features=tuple(half_turn)), part)
    rms = [float(np.sqrt(np.nanmean(each.distance_mm[side] ** 2))) for each in (found, off)]
    assert rms[1] > 5.0 * rms[0]


def test_the_ends_of_studs_are_on_no_surface() -> None:
    points, measured, part = stud_scene(1)
    found = residuals(points, measured, part)
    ends = found.local_mm[:, 2] > 31.5
    assert ends.sum() > 300 and np.all(found.surface[ends] == NONE)
