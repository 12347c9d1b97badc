"""What vision would have measured of a twin's part, drawn instead of rendered: noise, leans, ripple, scale, view.

For odds by the thousand. The noise of a feature is drawn as its covariance says: a place at the height where its axis
is known best, a lean, and the prior of leans that the estimator uses.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np

from cellctl.vision.part import FaceFit, FeatureFit, PartMeasurement
from cellctl.vision.pattern import fit_pattern, nominal
from hal.fake.plant import Plant
from hal.fake.scene.picture import scan_errors
from tests.docking.twin_cases import Case

Array = np.ndarray


@dataclass(frozen=True)
class Sight:
    """Noise of one feature: one sigma of its place at the height `pivot_mm` above the face, and of its lean."""

    place_mm: float
    pivot_mm: float
    lean_rad: float


SIGHTS = {"rotor": Sight(0.006, 22.0, 4.0e-4), "shaft": Sight(0.005, -2.0, 5.0e-4)}
"""About what a scan of 0.3 M points gives; a case has 0.7 to 2 times that."""


def drawn_measurement(
    plant: Plant, one: Case, view: Literal["rotor", "shaft"], draw: np.random.Generator
) -> PartMeasurement:
    """The part in the cell frame as it is believed, from the twin's truth."""
    truth = plant.rotor.stud_mm if view == "rotor" else plant.shaft.hole_mm
    slope = plant.rotor.slope if view == "rotor" else plant.shaft.slope
    T_cell_part = plant.T_cell_rotor() if view == "rotor" else plant.T_cell_shaft()
    sight, times = SIGHTS[view], float(draw.uniform(0.7, 2.0))
    prior = np.radians(plant.numbers.imperfections.feature_tilt_deg)
    lean = (sight.lean_rad**-2.0 + prior**-2.0) ** -0.5
    seen_slope = (slope + draw.normal(0.0, sight.lean_rad, slope.shape)) * (lean / sight.lean_rad) ** 2
    place_mm = times * sight.place_mm
    centre = truth + sight.pivot_mm * (slope - seen_slope) + draw.normal(0.0, place_mm, truth.shape)
    T_seen = one.calibration.views[view].matrix @ np.linalg.inv(plant.T_cell_camera(view))
    radius = 0.5 * float(np.mean(plant.rotor.diameter_mm if view == "rotor" else plant.shaft.diameter_mm))
    cell = _through_scanner(plant, view, np.column_stack([centre, np.zeros(len(centre))]), T_cell_part, radius)
    T = T_seen @ T_cell_part
    axes = np.column_stack([seen_slope, np.ones(len(centre))]) @ T[:3, :3].T
    cell = cell @ T_seen[:3, :3].T + T_seen[:3, 3]
    cell = cell - ((cell - T[:3, 3]) @ T[:3, 2])[:, None] * T[:3, 2]
    covariance = np.eye(3) * (place_mm**2 + (sight.pivot_mm * lean) ** 2)
    features = tuple(
        FeatureFit(i, True, c, a / np.linalg.norm(a), radius, covariance, float(np.degrees(lean)), sight.pivot_mm)
        for i, (c, a) in enumerate(zip(cell, axes, strict=True))
    )
    return _assembled(one, view, T, features)


def _through_scanner(
    plant: Plant, view: Literal["rotor", "shaft"], places: Array, T_cell_part: Array, radius_mm: float
) -> Array:
    """Places (n, 3) of the part in the true cell as the instrument's ripple and scale show them.

    A wave moves a feature along its ray, and its slope moves an edge `radius_mm` away sideways by slope times radius.
    """
    errors, T_cell_camera = scan_errors(plant), plant.T_cell_camera(view)
    there = np.linalg.inv(T_cell_camera) @ T_cell_part
    seen = places @ there[:3, :3].T + there[:3, 3]
    angle = np.radians(errors.ripple_angle_deg)
    direction = np.array([np.cos(angle), np.sin(angle), 0.0])
    wave = 2.0 * np.pi / errors.ripple_wavelength_mm
    phase = wave * (seen @ direction) + np.radians(errors.ripple_phase_deg)
    height, slope = np.sqrt(2.0) * errors.ripple_mm * np.array([np.sin(phase), wave * np.cos(phase)])
    along = height / np.linalg.norm(seen, axis=1)
    seen = seen * ((1.0 + errors.scale) * (1.0 + along))[:, None] + radius_mm * slope[:, None] * direction
    return np.asarray(seen @ T_cell_camera[:3, :3].T + T_cell_camera[:3, 3])


def _assembled(
    one: Case, view: Literal["rotor", "shaft"], T: Array, features: tuple[FeatureFit, ...]
) -> PartMeasurement:
    """Features on the face of pose `T` (4, 4), with the pattern fitted to them."""
    part = one.recipe.part(view)
    flat = np.array([(feature.center_mm - T[:3, 3]) @ T[:3, :2] for feature in features])
    variance = np.array([feature.covariance_mm2[0, 0] for feature in features])
    fitted = fit_pattern(part, flat, variance[:, None, None] * np.eye(2), _clocking(nominal(part), flat))
    c, s = np.cos(fitted.clocking_rad), np.sin(fitted.clocking_rad)
    own = np.eye(4)
    own[:2, :2] = [[c, -s], [s, c]]
    own[:2, 3] = fitted.centre_mm
    face = FaceFit(T[:3, 3], T[:3, 2], T[:3, :2].T, np.eye(3) * 1e-12, 0.03, 0.01, 1000, 0.99)
    return PartMeasurement(
        "cell", part.feature, face, T @ own, np.eye(6) * 1e-10, 0.001, True, features, fitted.diameter_mm
    )


def _clocking(model: Array, flat: Array) -> float:
    """Turn (rad) that carries the nominal places (n, 2) to the seen ones."""
    a, b = model - model.mean(axis=0), flat - flat.mean(axis=0)
    return float(np.arctan2(np.sum(a[:, 0] * b[:, 1] - a[:, 1] * b[:, 0]), np.sum(a * b)))
