"""The bound is a bound: an oracle that knows every label reaches it, and no more."""

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from tests.vision.bound_studs import OWN, SHARED, changed, close_up_bound, derivatives, polished, scene_bound
from tests.vision.stud_campaign import interval
from tests.vision.stud_scene import Errors, into_stud, random_scene, seen_from, trace
from tests.vision.thread_scene import Bolt, close_up

Array = NDArray[np.float64]


def shifted(bolt: Bolt, eye: Array, rays: Array, values: Array) -> tuple[Bolt, Array, Array]:
    """Bolt, eye and rays once all parameters have changed by `values`."""
    for name, value in zip(OWN + SHARED, values, strict=True):
        bolt, eye, rays = changed(bolt, eye, rays, name, value)
    return bolt, eye, rays


def test_an_oracle_reaches_the_bound_of_a_close_up() -> None:
    """Gauss-Newton on the marched surface itself, from the truth, with the points' labels: 120 seeds."""
    bolt = Bolt(radius=3.9471, pitch=1.2537, length=20.0)
    rng = np.random.default_rng(5)
    points, eye = close_up(bolt, rng, sigma=0.0, points=1500)
    depth = np.linalg.norm(points - eye, axis=1)
    rays = (points - eye) / depth[:, None]
    sigmas = np.full(len(depth), 0.03)
    bound = close_up_bound(bolt, eye, rays, depth, sigmas)
    rows = derivatives(bolt, eye, rays, depth)
    rays, depth = rays[rows.pixels], depth[rows.pixels]
    free = [0, 1, 2, 3, 4, 6, 7]
    design = np.column_stack([rows.own, rows.shared])[:, free]
    solve = np.linalg.pinv(design)
    errors = []
    for _ in range(120):
        measured = depth + rng.normal(0.0, 0.03, len(depth))
        values = np.zeros(len(OWN + SHARED))
        for _ in range(3):
            there = polished(*shifted(bolt, eye, rays, values), depth)
            miss = np.where(np.isfinite(there), measured - np.nan_to_num(there), 0.0)
            values[free] += solve @ miss
        errors.append(values[-2:])
    for column, sigma in zip(np.array(errors).T, bound, strict=True):
        reached = interval(column / sigma)
        assert reached["low"] < 1.0 < reached["high"], reached


def test_the_bound_of_a_scene_is_that_of_one_dense_problem() -> None:
    """The arrow form against all parameters of all studs at once, and an oracle on these rows over 200 seeds."""
    rng = np.random.default_rng(6)
    scene = random_scene(rng, 60_000, errors=Errors(growth=1.0, steep_deg=80.0, lost=0.0))
    scene = replace(scene, bolts=scene.bolts[:3], places=scene.places[:3], leans=scene.leans[:3])
    depth, owner, cosine = trace(scene)
    bound = scene_bound(scene, depth, owner, cosine)
    eye, rays = seen_from(scene)
    blocks, size = [], len(OWN)
    for index, bolt in enumerate(scene.bolts):
        mine = np.flatnonzero((owner == index) & (cosine >= np.cos(np.radians(80.0))))
        rows = derivatives(bolt, *into_stud(scene, index, eye, rays[mine]), depth[mine])
        sigma = scene.errors.sigma_mm / np.maximum(cosine[mine[rows.pixels]], 0.1)
        wide = np.zeros((len(sigma), 3 * size + 2))
        wide[:, index * size : (index + 1) * size], wide[:, -2:] = rows.own, rows.shared
        blocks.append(wide / sigma[:, None])
    design = np.concatenate(blocks)
    covariance = np.linalg.inv(design.T @ design)
    sigmas = np.sqrt(np.diag(covariance))
    np.testing.assert_allclose(sigmas[-2:], [bound.radius_mm, bound.pitch_mm], rtol=1e-3)
    np.testing.assert_allclose(sigmas[:-2].reshape(3, size)[:, :2], bound.place_mm, rtol=1e-3)
    found = covariance @ design.T @ rng.standard_normal((len(design), 200))
    for column, sigma in zip(found[[0, size, -2, -1]], sigmas[[0, size, -2, -1]], strict=True):
        reached = interval(column / sigma)
        assert reached["low"] < 1.0 < reached["high"], reached
