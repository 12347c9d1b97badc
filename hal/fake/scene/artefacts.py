"""What stands on the bench beside the parts, as drawn and built: artefact posts, clamps, pipes. Cell frame, mm.

The same numbers stand in the calibration certificate, as they would on a real bench; neither is made from the other.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from hal.fake.scene.shapes import Clutter

Point = tuple[float, float, float]


@dataclass(frozen=True, slots=True)
class BenchFurniture:
    """Two-sided artefact on four posts, the chuck's clamps and two pipes."""

    sphere_diameter_mm: float = 20.0
    rotor_side_mm: tuple[Point, ...] = (
        (135.0, 135.0, 385.0),
        (-135.0, 133.0, 380.0),
        (-133.0, -135.0, 390.0),
        (135.0, -131.0, 375.0),
    )
    shaft_side_mm: tuple[Point, ...] = (
        (135.0, 135.0, 15.0),
        (-135.0, 133.0, 20.0),
        (-133.0, -135.0, 10.0),
        (135.0, -131.0, 25.0),
    )
    post_offset: float = 1.15
    """Posts stand further out than the spheres by this factor and hold them on stems."""
    post_radius_mm: float = 8.0
    stem_radius_mm: float = 3.0
    clamp_angles_deg: tuple[float, ...] = (12.0, 132.0, 252.0)
    clamp_reach_mm: tuple[float, float] = (161.0, 190.0)
    """From the inner to the outer end, measured from the table's axis."""
    clamp_height_mm: float = -14.0
    clamp_radius_mm: float = 7.0
    pipes_mm: tuple[tuple[Point, Point, float], ...] = (
        ((-200.0, 160.0, 412.0), (200.0, 163.0, 408.0), 5.0),
        ((-200.0, -164.0, -20.0), (200.0, -162.0, -14.0), 6.0),
    )
    """Ends and radius."""

    def clutter(self) -> Clutter:
        """All of it as solids for the scene."""
        spheres = np.array(self.rotor_side_mm + self.shaft_side_mm)
        feet = spheres * [self.post_offset, self.post_offset, 1.0]
        bars = [np.stack([spheres, feet], axis=1)]
        radius = [self.stem_radius_mm] * len(spheres)
        post = feet[: len(self.rotor_side_mm)]
        bars.append(np.stack([post * [1.0, 1.0, 0.0], post * [1.0, 1.0, 0.0] + [0.0, 0.0, 400.0]], axis=1))
        radius += [self.post_radius_mm] * len(post)
        angle = np.radians(self.clamp_angles_deg)
        out = np.column_stack([np.cos(angle), np.sin(angle), np.zeros(len(angle))])
        level = np.array([0.0, 0.0, self.clamp_height_mm])
        bars.append(np.stack([reach * out + level for reach in self.clamp_reach_mm], axis=1))
        radius += [self.clamp_radius_mm] * len(angle)
        bars.append(np.array([[start, end] for start, end, _ in self.pipes_mm]))
        radius += [pipe[2] for pipe in self.pipes_mm]
        return Clutter(spheres, 0.5 * self.sphere_diameter_mm, np.concatenate(bars), np.array(radius))
