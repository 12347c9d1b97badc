"""The noise-free picture lies on the analytic surfaces, and both eyes see what it shows."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest
from numpy.typing import NDArray

from hal.fake.scene.camera import IDEAL, camera_for
from hal.fake.scene.render import SceneState, render, trace
from hal.fake.scene.shapes import Clutter
from hal.fake.scene.thread_form import StudForm
from tests.hal.fake.scene_model import all_deviations, inside, into, rotor_shape, scene

LIMIT_MM = 0.0002


def valid_points(cloud: NDArray[np.float32]) -> NDArray[np.float64]:
    flat = cloud.reshape(-1, 3).astype(np.float64)
    return flat[np.isfinite(flat[:, 0])]


@pytest.mark.parametrize(
    ("view", "form", "wanted"),
    [
        ("shaft", None, {"ring0", "ring1", "bevel", "chamfer", "wall", "sphere", "bar"}),
        ("rotor", None, {"ring0", "ring1", "ring2", "bevel", "crest", "flank", "tip", "lead_in", "sphere", "bar"}),
        ("rotor", StudForm(4.97, 1.37, hand=-1, starts=2, length_mm=28.3), {"crest", "flank", "tip", "lead_in"}),
    ],
)
def test_every_point_lies_on_its_surface(view: str, form: StudForm | None, wanted: set[str]) -> None:
    state = scene(view, form=form)
    points = valid_points(render(state, 1))
    distance, names = all_deviations(state, view, points)
    assert distance.max() < LIMIT_MM
    few = {name: int(np.sum(names == name)) for name in wanted if np.sum(names == name) < 50}
    assert not few, f"hardly seen: {few}"


def test_a_wrong_thread_is_off_the_picture() -> None:
    """The test above would notice another hand, pitch or phase."""
    state = scene("rotor")
    points = valid_points(render(state, 1))
    T, shape = state.parts[1]
    assert shape.studs is not None
    for other in (
        dataclasses.replace(shape.studs, form=StudForm(hand=-1)),
        dataclasses.replace(shape.studs, form=StudForm(pitch_mm=1.01)),
        dataclasses.replace(shape.studs, phase=shape.studs.phase + 0.01),
    ):
        wrong = dataclasses.replace(state, parts=(state.parts[0], (T, dataclasses.replace(shape, studs=other))))
        assert all_deviations(wrong, "rotor", points)[0].max() > 10.0 * LIMIT_MM


@pytest.mark.parametrize("view", ["shaft", "rotor"])
def test_both_eyes_see_every_point_and_what_is_dark_is_hidden(view: str) -> None:
    """Lines of sight marched in 0.05 mm steps through the solid agree with the renderer's closed forms.

    Other than edges closer than a step, the renderer is strict where a stud's shadow falls on other things: it takes
    the crest cylinder for the thread.
    """
    state = scene(view, points=90_000)
    T, shape = state.parts[0 if view == "shaft" else 1]
    bare = dataclasses.replace(state, clutter=Clutter(), parts=((T, shape),))
    hits = trace(bare)
    rng = np.random.default_rng(5)
    T_camera_part = np.linalg.inv(bare.T_cell_camera) @ T
    interesting = np.isfinite(hits.depth) & ((hits.owner != 0) | hits.dark)
    lit = rng.permutation(np.flatnonzero(interesting & ~hits.dark))[:1200]
    dark = rng.permutation(np.flatnonzero(interesting & hits.dark))[:600]

    def seen_by_both(pixels: NDArray[np.intp], tiny: float) -> tuple[NDArray[np.bool_], NDArray[np.bool_]]:
        p = into(T_camera_part, hits.points(pixels))
        clear, facing = np.ones(len(pixels), dtype=np.bool_), np.ones(len(pixels), dtype=np.bool_)
        for eye in bare.camera.eyes_mm:
            e = into(T_camera_part, np.array([eye]))[0]
            towards = (e - p) / np.linalg.norm(e - p, axis=1, keepdims=True)
            normal = hits.normal[pixels] @ T_camera_part[:3, :3]
            facing &= np.sum(normal * towards, axis=1) > np.cos(np.radians(80.0))
            for step in np.arange(0.05, 36.0, 0.05):
                clear &= ~inside(shape, p + step * towards, tiny)
        return clear, facing

    clear, facing = seen_by_both(lit, 0.02)
    # A surface that turns away from an eye is the business of the incidence limit.
    assert (~clear & facing).mean() < 0.002
    assert len(dark) > 50
    assert seen_by_both(dark, 0.001)[0].mean() < 0.08


def test_a_part_that_turns_its_back_is_not_seen() -> None:
    state = scene("rotor")
    away = dataclasses.replace(state, parts=(state.parts[0],), clutter=Clutter())
    assert np.isnan(render(away, 1)).all()
    assert np.isnan(render(SceneState(T_cell_camera=np.eye(4)), 1)).all()


def test_what_stands_in_front_hides_what_lies_behind() -> None:
    state = scene("shaft", points=40_000)
    bar = Clutter(bars_mm=np.array([[[120.0, -200.0, 60.0], [120.0, 200.0, 60.0]]]), bar_radius_mm=np.array([12.0]))
    before, after = (
        render(dataclasses.replace(state, clutter=Clutter()), 1),
        render(dataclasses.replace(state, clutter=bar), 1),
    )
    cell = after.reshape(-1, 3) @ state.T_cell_camera[:3, :3].T + state.T_cell_camera[:3, 3]
    on_bar = np.abs(np.hypot(cell[:, 0] - 120.0, cell[:, 2] - 60.0) - 12.0) < LIMIT_MM
    assert on_bar.sum() > 1000
    # The eyes look past the bar on both sides, so that it costs more than it covers.
    lost = np.isfinite(before.reshape(-1, 3)[:, 0]) & ~np.isfinite(after.reshape(-1, 3)[:, 0])
    assert lost.sum() > 500


def test_eyes_far_apart_see_less() -> None:
    state = scene("rotor", points=90_000)
    wide = dataclasses.replace(state.camera, eyes_mm=((-120.0, 0.0, 0.0), (120.0, 0.0, 0.0)))
    one = dataclasses.replace(state.camera, eyes_mm=((0.0, 0.0, 0.0),))
    seen = [
        np.isfinite(render(dataclasses.replace(state, camera=camera), 1)).sum() for camera in (wide, state.camera, one)
    ]
    assert seen[0] < 0.99 * seen[1]
    assert seen[1] < 0.995 * seen[2]


def test_the_grid_is_the_pinhole_grid_and_as_large_as_asked() -> None:
    for points in (90_000, 500_000):
        camera = camera_for(points)
        assert camera.rows * camera.cols == pytest.approx(points, rel=0.01)
    state = scene("shaft", points=90_000)
    cloud = render(state, 1).astype(np.float64)
    u, v = (slope.reshape(300, 300) for slope in camera_for(90_000).slopes())
    valid = np.isfinite(cloud[..., 2])
    np.testing.assert_allclose((cloud[..., 0] / cloud[..., 2])[valid], u[valid], atol=1e-7)
    np.testing.assert_allclose((cloud[..., 1] / cloud[..., 2])[valid], v[valid], atol=1e-7)
    assert u.max() * 350.0 == pytest.approx(165.0)


def test_a_part_seen_square_on_keeps_its_drawing() -> None:
    """Hand-made case: face 350 mm away, square to the camera."""
    T = np.diag([1.0, -1.0, -1.0, 1.0])
    T[2, 3] = 350.0
    state = SceneState(np.eye(4), ((T, rotor_shape()),), camera=camera_for(60_000), errors=IDEAL)
    depth = valid_points(render(state, 1))[:, 2]
    assert np.isclose(depth, 350.0, atol=1e-4).sum() > 0.3 * depth.size
    assert np.isclose(depth, 355.0, atol=1e-4).any()
    assert depth.min() == pytest.approx(318.0, abs=0.02)
