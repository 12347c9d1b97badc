"""Joints that nobody chose: random sizes, counts, angles and poses for accuracy campaigns."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from cellctl.vision.part import Part
from tests.vision.synthetic import View, pose_above

Array = NDArray[np.float64]


def random_part(rng: np.random.Generator) -> Part:
    """A drilled and chamfered annular face: 6 to 72 holes, equal or unequal angles, with or without an index."""
    ring = rng.uniform(45.0, 140.0)
    count = int(rng.integers(6, 73))
    room = 2.0 * np.pi * ring / count
    wall = 0.5 * float(np.clip(rng.uniform(0.3, 0.55) * room, 4.5, 16.0))
    chamfer = wall + rng.uniform(0.5, 1.3)
    while 2.0 * np.pi * ring / count < 2.0 * chamfer + 3.0:
        count -= 1
    angles = np.arange(count) * 360.0 / count
    if rng.random() < 0.4:  # unequal: some places left out of a finer division
        division = count + int(rng.integers(1, 4))
        if 2.0 * np.pi * ring / division > 2.0 * chamfer + 2.0:
            angles = np.sort(rng.permutation(division)[:count]) * 360.0 / division
    width = chamfer + rng.uniform(12.0, 20.0)  # room for a clamp that hides no hole
    return Part(
        "hole", 2.0 * ring, tuple(float(angle) for angle in angles), diameter_mm=(2.0 * wall,) * count,
        chamfer_diameter_mm=2.0 * chamfer, chamfer_angle_deg=float(rng.choice([30.0, 45.0, 45.0, 60.0])),
        depth_mm=float(rng.uniform(8.0, 25.0)), face_inner_diameter_mm=2.0 * max(ring - width, 8.0),
        face_outer_diameter_mm=2.0 * (ring + width), ledge_step_mm=float(rng.uniform(3.0, 8.0)),
    )  # fmt: skip


def random_view(rng: np.random.Generator, points: int, **values: object) -> View:
    """`random_part` at 300 to 400 mm, tilted by up to a degree, any clocking, holes 0.01 mm and 0.02 degrees off."""
    part = random_part(rng)
    pose = pose_above(rng.uniform(300.0, 400.0), tuple(rng.uniform(-0.017, 0.017, 2)), rng.uniform(-np.pi, np.pi),
                      tuple(rng.normal(0.0, 3.0, 2)))  # fmt: skip
    view = View(
        part, pose, pixels=round(np.sqrt(points)), field_mm=(part.face_outer_diameter_mm or 0.0) + 30.0,
        offsets_mm=rng.normal(0.0, 0.01, (part.count, 2)), tilts_rad=rng.normal(0.0, np.radians(0.02), (part.count, 2)),
    )  # fmt: skip
    return replace(view, **values)  # type: ignore[arg-type]


def stressed_view(rng: np.random.Generator, points: int) -> View:
    """`random_view` under stress: noise 0.05 mm shared over 3 pixels, 0.02 mm ripple, 6 % outliers, tilt 3 degrees."""
    view = random_view(rng, points, sigma_mm=0.05, correlation_px=3.0, ripple_mm=0.02, outliers=0.06)
    around = rng.uniform(-np.pi, np.pi)
    tilt = np.radians(3.0) * np.array([np.cos(around), np.sin(around)])
    pose = pose_above(rng.uniform(300.0, 400.0), (float(tilt[0]), float(tilt[1])), rng.uniform(-np.pi, np.pi))
    return replace(view, T_scanner_part=pose)


def hide(cloud: NDArray[np.float32], rng: np.random.Generator, share: float = 0.2) -> NDArray[np.float32]:
    """The cloud with a band along one side of the view missing, `share` of it."""
    result = cloud.copy()
    rows, columns = cloud.shape[:2]
    side = int(rng.integers(4))
    cut = (np.s_[: round(share * rows)], np.s_[round((1 - share) * rows) :],
           np.s_[:, : round(share * columns)], np.s_[:, round((1 - share) * columns) :])[side]  # fmt: skip
    result[cut] = np.nan
    return result
