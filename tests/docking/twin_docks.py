"""One dock of a calibration campaign: measured by real vision or a drawn measurement, aligned, judged by the truth."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Literal

import numpy as np

from cellctl.docking import Alignment, align, align_spec
from cellctl.kinematics import Array, AxesPosition
from cellctl.vision.measure import measure_part
from cellctl.vision.part import PartMeasurement
from hal.fake.contact.curve import force_curve, gap_grid
from hal.fake.contact.docking import pose_error
from hal.fake.contact.insertion import Dock, meeting
from hal.fake.plant import Plant
from hal.fake.scene.picture import picture_of
from hal.fake.scene.render import render
from tests.docking.drawn_measurement import drawn_measurement
from tests.docking.twin_cases import Case

HOME = AxesPosition(0.0, 0.0, 0.0, 0.0)
LONG_S = 1000.0
TO_DEG = np.array([1.0, 1.0, 180.0 / np.pi])


@dataclass(frozen=True, slots=True)
class Docked:
    """A dock that stands under the rotor with its last alignment. Errors (3,): x mm, y mm, theta deg, pose minus best.

    `best_error` is against the pose that leaves the worst stud the most clearance, `mean_error` against the least
    squares of all studs. `free`: no stud touches anything up to the spigot; `total_n`, `bolt_n` the peak forces.
    """

    alignment: Alignment
    best_error: Array
    mean_error: Array
    free: bool
    total_n: float
    bolt_n: float


def docked(one: Case, *, points: int = 0, moves: int = 1, samples: int = 4096) -> Docked:
    """Scan both parts, align, move; after each of `moves` - 1 further motions scan the shaft and align again.

    `points` 0 draws what vision would have measured. Raises Refused.
    """
    plant, noise = one.plant(), np.random.default_rng([one.seed, 2])
    spec = replace(align_spec(one.recipe), samples=samples)
    rough = replace(spec, samples=2)  # samples do not move the target, and only the last forecast is asked for

    def measured(view: Literal["rotor", "shaft"]) -> PartMeasurement:
        if points == 0:
            return drawn_measurement(plant, one, view, noise)
        cloud = render(picture_of(plant, view, points), int(noise.integers(2**62)))
        return measure_part(cloud, one.recipe.part(view), one.calibration.views[view].matrix)

    rotor, at = measured("rotor"), HOME
    for left in reversed(range(moves)):
        alignment = align(rotor, measured("shaft"), one.calibration, at, rough if left else spec)
        at = _move(plant, alignment)
    return _judged(plant.dock(), alignment)


def _move(plant: Plant, alignment: Alignment) -> AxesPosition:
    target = alignment.target
    for axis, place in (("stage_x", target.x_mm), ("stage_y", target.y_mm), ("shaft_table", target.theta_deg)):
        plant.start_move(axis, place, speed=10.0, acceleration=50.0, now=plant.now)
    plant.advance(plant.now + LONG_S)
    return AxesPosition(target.x_mm, target.y_mm, 0.0, target.theta_deg)


def _judged(dock: Dock, alignment: Alignment) -> Docked:
    gaps = gap_grid(dock)
    curve = force_curve(dock, gaps[gaps > dock.geometry.spigot_length_mm])
    error = pose_error(dock)
    return Docked(
        alignment=alignment,
        best_error=np.array([error.x_mm, error.y_mm, error.theta_deg]),
        mean_error=_mean_error(dock),
        free=not curve.touches,
        total_n=float(curve.in_n.max()),
        bolt_n=float(curve.stud_in_n.max()),
    )


def _mean_error(dock: Dock) -> Array:
    """Least squares of the studs' offsets on the face, about the rotor's axis."""
    met = meeting(dock, dock.heights_mm(np.zeros(1)))
    offset = met.offset_mm(np.zeros_like(met.gap_mm))[0]
    arm = met.hole_mm[0] - dock.rotor.T_cell_rotor[:2, 3]
    design = np.zeros((len(arm), 2, 3))
    design[:, 0, 0] = design[:, 1, 1] = 1.0
    design[:, 0, 2], design[:, 1, 2] = -arm[:, 1], arm[:, 0]
    return -np.linalg.lstsq(design.reshape(-1, 3), offset.ravel(), rcond=None)[0] * TO_DEG
