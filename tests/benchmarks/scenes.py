"""What is measured: clouds of the analytic renderer, the part in them, its true pose, and what an engineer would know.

A scene is drawn from a seed alone. Millimetres, scanner frame unless said otherwise.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from cellctl.vision.part import Part, Thread
from hal.fake.scene.camera import ScanErrors, camera_for
from hal.fake.scene.render import SceneState
from hal.fake.scene.render import render as picture
from hal.fake.scene.shapes import PartShape, Studs
from hal.fake.scene.thread_form import StudForm
from tests.vision.synthetic import View, pose_above, render, true_centres

Array = NDArray[np.float64]

HALF_WINDOW_MM = 25.0
"""Of the working distance: the cheap cut along z that keeps the library pipelines from looking at the backdrop."""


@dataclass(frozen=True)
class Scene:
    """A cloud (H, W, 3) or (N, 3), the part in it, its true pose and a taught pose that is off by a little.

    `taught` (4, 4) is what the library pipelines get: they have no search for the pattern. Ours gets none.
    """

    cloud: NDArray[np.float32]
    part: Part
    truth: Array
    taught: Array
    seen: NDArray[np.bool_]

    @property
    def points(self) -> int:
        """Valid points."""
        return int(np.isfinite(self.cloud[..., 0]).sum())

    def job(self) -> dict[str, Any]:
        """What a pipeline in another process is told, as JSON: sizes, nominal places and the taught pose."""
        part, angles = self.part, np.radians(self.part.angles_deg)
        places = 0.5 * part.circle_diameter_mm * np.column_stack([np.cos(angles), np.sin(angles)])
        mouths = (part.chamfer_diameter_mm,) * part.count if part.chamfer_diameter_mm else part.diameter_mm
        height = float(self.taught[2, 3])
        return {
            "near_mm": height - HALF_WINDOW_MM,
            "far_mm": height + HALF_WINDOW_MM,
            "taught": self.taught.tolist(),
            "places_mm": places.tolist(),
            "wall_mm": self._wall_mm(),
            "mouth_radii_mm": [0.5 * mouth for mouth in mouths or ()],
        }

    def _wall_mm(self) -> tuple[float, float]:
        """Depths below the face between which there is wall and neither chamfer nor end, with a margin."""
        part = self.part
        slope = np.tan(np.radians(part.chamfer_angle_deg or 45.0))
        chamfer = 0.5 * ((part.chamfer_diameter_mm or 0.0) - max(part.diameter_mm or (0.0,))) / slope
        return max(0.0, float(chamfer)) + 0.3, (part.depth_mm or 0.0) - 0.5


def joint(count: int = 36, hole_mm: float = 8.5, chamfer_mm: float = 10.5) -> Part:
    """Holes on a circle of 250 mm in a ring face of 200 to 290 mm, equal angles."""
    return Part(
        "hole",
        250.0,
        tuple(360.0 * i / count for i in range(count)),
        diameter_mm=(hole_mm,) * count,
        chamfer_diameter_mm=chamfer_mm,
        chamfer_angle_deg=45.0,
        depth_mm=14.0,
        face_inner_diameter_mm=200.0,
        face_outer_diameter_mm=290.0,
        ledge_step_mm=5.0,
    )


def plain(points: int, seed: int, part: Part | None = None) -> Scene:
    """About `points` valid points of a joint under white noise of 0.03 mm with 2 % outliers, tilted by 1 degree."""
    rng = np.random.default_rng([seed, points])
    heading = rng.uniform(0.0, 2.0 * np.pi)
    tilt = np.radians(1.0) * np.array([np.cos(heading), np.sin(heading)])
    shift = rng.uniform(-2.0, 2.0, 2)
    pose = pose_above(350.0, (tilt[0], tilt[1]), rng.uniform(-np.pi, np.pi), (shift[0], shift[1]))
    # of all pixels, 2 % are lost and some look through a hole
    view = View(part or joint(), pose, pixels=round((points / 0.974) ** 0.5))
    return Scene(render(view, rng), view.part, pose, taught(pose, rng), np.ones(view.part.count, dtype=bool))


def studs(points: int, seed: int, count: int = 36) -> Scene:
    """About `points` valid points of M8x1.25 studs of 32 mm on a circle of 250 mm over a backdrop, with the twin's own
    errors."""
    rng = np.random.default_rng([seed, points, 2])
    angles = 360.0 / count * np.arange(count)
    centres = 125.0 * np.column_stack([np.cos(np.radians(angles)), np.sin(np.radians(angles))])
    form = StudForm(3.98, pitch_mm=1.25)
    shape = PartShape(
        rings_mm=((100.0, 145.0, 0.0), (145.0, 160.0, -5.0), (0.0, 400.0, -60.0)),
        studs=Studs(centres, np.tile([0.0, 0.0, 1.0], (count, 1)), rng.random(count), form),
    )
    part = Part(
        "stud", 250.0, tuple(angles), diameter_mm=(8.0,) * count, length_mm=32.0, thread=Thread(8.0, 1.25),
        face_inner_diameter_mm=200.0, face_outer_diameter_mm=290.0,
    )  # fmt: skip
    pose = pose_above(350.0, (0.01, -0.01), float(rng.uniform(-0.05, 0.05)))
    camera = camera_for(round(points / 0.884))  # of all pixels, 12 % are lost or shadowed by a stud
    scene = SceneState(np.eye(4), ((pose, shape),), camera=camera, errors=ScanErrors())
    return Scene(picture(scene, seed), part, pose, pose, np.ones(count, dtype=bool))


def stressed(seed: int) -> Scene:
    """Everything at once: sizes, counts and angles at random, noise of 0.05 mm shared over 3 pixels, ripple of
    0.02 mm, 6 % outliers, clutter, a fifth of the view missing, 3 degrees of tilt.
    """
    rng = np.random.default_rng([seed, 3])
    part = _random_part(rng)
    heading = rng.uniform(0.0, 2.0 * np.pi)
    tilt = np.radians(3.0) * np.array([np.cos(heading), np.sin(heading)])
    shift = rng.uniform(-3.0, 3.0, 2)
    pose = pose_above(rng.uniform(310.0, 390.0), (tilt[0], tilt[1]), rng.uniform(-np.pi, np.pi), (shift[0], shift[1]))
    view = View(
        part, pose, pixels=round(rng.uniform(560, 1000)), field_mm=1.1 * (part.face_outer_diameter_mm or 0.0),
        sigma_mm=0.05, correlation_px=3.0, ripple_mm=0.02, outliers=0.06,
    )  # fmt: skip
    cloud = render(view, rng)
    gone = _missing(view.pixels, 0.2, rng)
    cloud[gone] = np.nan
    return Scene(cloud, part, pose, taught(pose, rng), _seen(view, gone))


def taught(pose: Array, rng: np.random.Generator) -> Array:
    """The true pose turned by up to 0.2 degrees about each axis and shifted by up to 0.3 mm along each."""
    turn = np.radians(rng.uniform(-0.2, 0.2, 3))
    off = pose_above(0.0, (turn[0], turn[1]), turn[2])
    off[:3, :3] = np.diag([1.0, -1.0, -1.0]) @ off[:3, :3]
    off[:3, 3] = rng.uniform(-0.3, 0.3, 3)
    return np.asarray(pose @ off)


def _random_part(rng: np.random.Generator) -> Part:
    """Count, sizes and angles at random; neighbours keep 1.5 mouths of distance. One part in three has equal angles."""
    count, circle = int(rng.integers(5, 61)), float(rng.uniform(140.0, 300.0))
    room = np.pi * circle / count
    hole = float(rng.uniform(4.0, min(14.0, max(4.5, 0.5 * room))))
    chamfer = hole + float(rng.uniform(1.2, 2.4))
    spread = 0.0 if rng.random() < 1 / 3 else max(0.0, 1.0 - 1.5 * chamfer / room)
    angles = 360.0 / count * (np.arange(count) + 0.5 * spread * rng.uniform(-1.0, 1.0, count))
    wide = 0.5 * (circle + chamfer)
    inner, outer = wide - chamfer - rng.uniform(5.0, 20.0), wide + rng.uniform(5.0, 20.0)
    return Part(
        "hole",
        circle,
        tuple(float(angle) for angle in angles),
        diameter_mm=(hole,) * count,
        chamfer_diameter_mm=chamfer,
        chamfer_angle_deg=45.0,
        depth_mm=float(rng.uniform(10.0, 20.0)),
        face_inner_diameter_mm=2.0 * inner,
        face_outer_diameter_mm=2.0 * outer,
        ledge_step_mm=float(rng.uniform(3.0, 8.0)),
    )


def _missing(pixels: int, share: float, rng: np.random.Generator) -> NDArray[np.bool_]:
    """Discs of missing pixels, a twentieth to a tenth of the view wide, until `share` of the view is gone."""
    rows, columns = np.mgrid[:pixels, :pixels]
    gone = np.zeros((pixels, pixels), dtype=bool)
    while gone.mean() < share:
        row, column = rng.uniform(0.0, pixels, 2)
        gone |= np.hypot(rows - row, columns - column) < 0.5 * pixels * rng.uniform(0.05, 0.1)
    return gone


def _seen(view: View, gone: NDArray[np.bool_]) -> NDArray[np.bool_]:
    """Holes (n,) of which at least half of the mouth is left in the picture."""
    n, angles = view.pixels, np.linspace(0.0, 2.0 * np.pi, 72, endpoint=False)
    mouth = 0.5 * (view.part.chamfer_diameter_mm or 0.0) * np.column_stack([np.cos(angles), np.sin(angles)])
    left = []
    for centre in true_centres(view):
        rim = np.column_stack([centre[:2] + mouth, np.zeros(len(mouth))])
        at = rim @ view.T_scanner_part[:3, :3].T + view.T_scanner_part[:3, 3]
        pixel = np.floor((at[:, :2] / at[:, 2:] * view.T_scanner_part[2, 3] / view.field_mm + 0.5) * n).astype(int)
        inside = ((pixel >= 0) & (pixel < n)).all(axis=1)
        pixel = np.clip(pixel, 0, n - 1)
        left.append(np.mean(inside & ~gone[pixel[:, 1], pixel[:, 0]]) >= 0.5)
    return np.array(left)
