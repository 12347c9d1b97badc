"""The threaded stud: its radius against ISO 68-1, first hits against a dense march, normals against differences."""

from __future__ import annotations

import numpy as np
import pytest

from hal.fake.scene.thread_form import StudForm, blocked, first_hit, height, normals, surface_radius

FORMS = [StudForm(), StudForm(5.013, 1.27, starts=3, hand=-1, length_mm=21.7, lead_in_tan=0.7)]


def test_profile_has_the_sizes_of_the_standard() -> None:
    form = StudForm(crest_radius_mm=4.0, pitch_mm=1.0)
    z = np.arange(0.0, 1.0, 1e-5)
    radius = surface_radius(form, 10.0 + z, np.zeros_like(z), np.zeros_like(z))
    assert radius.max() == pytest.approx(4.0)
    assert radius.min() == pytest.approx((8.0 - 1.22687) / 2.0, abs=1e-5)
    assert np.mean(radius > 4.0 - 1e-9) == pytest.approx(1.0 / 8.0, abs=1e-4)
    # At the pitch diameter d2 = d - 0.649519 P ridge and groove are equally wide.
    assert np.mean(radius > (8.0 - 0.649519) / 2.0) == pytest.approx(0.5, abs=1e-4)


@pytest.mark.parametrize("form", FORMS)
def test_a_turn_advances_by_the_lead_in_the_hand_of_the_thread(form: StudForm) -> None:
    rng = np.random.default_rng(1)
    z, phase = rng.uniform(2.0, 12.0, 200), rng.random(200)
    lead = form.hand * form.starts * form.pitch_mm
    for turn in (0.1, 0.25, 0.4):
        here = surface_radius(form, z, np.zeros(200), phase)
        there = surface_radius(form, z + turn * lead, np.full(200, 2.0 * np.pi * turn), phase)
        np.testing.assert_allclose(there, here, atol=1e-12)


@pytest.mark.parametrize("form", FORMS)
def test_first_hit_is_the_first_and_exact(form: StudForm) -> None:
    rng = np.random.default_rng(2)
    n = 300
    angle, slope = rng.uniform(0.0, 2.0 * np.pi, n), rng.uniform(0.15, 0.5, n)
    at = rng.uniform(3.0, form.length_mm, n)
    # Rays that cross the stud's axis within 2.5 mm, coming down from outside.
    ray = np.column_stack([-slope * np.cos(angle), -slope * np.sin(angle), -np.ones(n)])
    aside = rng.uniform(-2.5, 2.5, n)
    through = np.column_stack([-aside * np.sin(angle), aside * np.cos(angle), at - 15.0])
    reach = np.sqrt(form.crest_radius_mm**2 - aside**2) / slope
    start, end = -reach, -reach + 30.0
    phase = rng.random(n)
    below_tip = through[:, 2] - start < form.length_mm - 1.0
    through, ray, start, end, phase = (
        through[below_tip], ray[below_tip], start[below_tip], end[below_tip], phase[below_tip]
    )  # fmt: skip
    found = first_hit(form, through, ray, start, end, phase)
    assert np.isfinite(found).all()
    p = through + found[:, None] * ray
    assert np.abs(height(form, p[:, 0], p[:, 1], p[:, 2], phase)).max() < 1e-9
    shares = np.linspace(0.0, 1.0, 4000, endpoint=False)[1:]
    for share in shares:
        q = through + (start + share * (found - start) * (1.0 - 1e-9))[:, None] * ray
        assert height(form, q[:, 0], q[:, 1], q[:, 2], phase).min() > -1e-9


def test_a_ray_beside_the_stud_hits_nothing() -> None:
    form = StudForm()
    origin, ray = np.array([[3.99, 0.0, 20.0]]), np.array([[0.2, 0.0, -1.0]])
    assert np.isinf(first_hit(form, origin, ray, np.array([0.06]), np.array([10.0]), np.zeros(1))).all()
    assert np.isinf(first_hit(form, origin, ray, np.array([2.0]), np.array([1.0]), np.zeros(1))).all()


@pytest.mark.parametrize("form", FORMS)
def test_normals_are_the_gradient(form: StudForm) -> None:
    rng = np.random.default_rng(3)
    phi, z, phase = rng.uniform(-3.0, 3.0, 500), rng.uniform(1.0, form.length_mm - 0.01, 500), rng.random(500)
    r = surface_radius(form, z, phi, phase)
    p = np.column_stack([r * np.cos(phi), r * np.sin(phi), z])
    step = 1e-6
    gradient = np.stack(
        [
            (height(form, *(p + step * e).T, phase) - height(form, *(p - step * e).T, phase)) / (2.0 * step)
            for e in np.eye(3)
        ],
        axis=1,
    )
    gradient /= np.linalg.norm(gradient, axis=1, keepdims=True)
    error = np.linalg.norm(gradient - normals(form, *p.T, phase), axis=1)
    assert np.mean(error < 1e-5) > 0.98  # the rest straddles an edge of the profile


def test_the_far_side_is_blocked_and_the_near_side_free() -> None:
    form = StudForm()
    z = np.linspace(5.0, 25.0, 400)
    r = surface_radius(form, z, np.zeros_like(z), np.zeros_like(z))
    # Upper flanks, clear of the corners with crest and root.
    flank_up = normals(form, r, np.zeros_like(z), z, np.zeros_like(z))[:, 2] > 0.1
    flank_up &= (r > form.root_radius_mm + 0.01) & (r < form.crest_radius_mm - 0.01)
    point = np.column_stack([r, np.zeros_like(z), z])[flank_up]
    phase = np.zeros(len(point))
    assert not blocked(form, point, np.tile([1.5, 0.0, 1.0], (len(point), 1)), phase).any()
    assert blocked(form, point, np.tile([-0.2, 0.0, 1.0], (len(point), 1)), phase).all()
