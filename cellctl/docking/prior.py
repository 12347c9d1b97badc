"""What a measured pattern is believed to be: the drawing's positions hold within their tolerance. Pure.

A hole seen with 20 um of noise on a part whose holes are drilled to 10 um is more likely near its place in the pattern
than where it was seen. Without this the minimax polish would follow the noise of the worst measurement.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from cellctl.docking.ripple import RippleNoise
from cellctl.kinematics import Array
from cellctl.vision.part import FeatureFit, PartMeasurement


def believed(
    part: PartMeasurement, angles_deg: tuple[float, ...], sigma_mm: float, ripple: RippleNoise
) -> tuple[PartMeasurement, Array]:
    """The measurement with each centre drawn towards its place in the fitted pattern (normal prior, per axis).

    Also returned: the share (n,) of what each centre was seen off its place that is kept. `angles_deg` are the
    pattern's angles in the part's own frame, `sigma_mm` the scatter that the drawing's position tolerance stands for.
    The scatter that the measurement itself shows beyond its own noise and the scanner's `ripple` is used where it is
    clearly larger (method of moments, less one standard error): a part out of tolerance is believed to be so. A lean
    that goes with the error of the centre is corrected along with it.
    """
    places = _places(part, angles_deg)
    across = part.T_frame_part[:3, :2]
    centres = np.array([feature.center_mm for feature in part.features])
    rest = (centres - places) @ across
    noise = np.array([_noise_mm2(feature, across) for feature in part.features]) + ripple.own_mm2
    # centre, clocking and diameter of the pattern were fitted to the same centres
    free = max(rest.size - 4, 1)
    total = noise + ripple.waves_mm2
    spread = float(np.sum(rest * rest)) / free
    scatter = max(sigma_mm**2, spread * (1.0 - np.sqrt(2.0 / free)) - float(np.mean(total)))
    share = scatter / (scatter + total)
    features = tuple(
        _drawn(feature, part.face.normal, across @ miss, (own, every, scatter))
        for feature, miss, own, every in zip(part.features, rest, noise, total, strict=True)
    )
    return replace(part, features=features), share


def _drawn(feature: FeatureFit, normal: Array, miss: Array, variances: tuple[float, float, float]) -> FeatureFit:
    """One feature seen `miss` (3,) mm off its place; variances (mm2) of its own noise, of all noise, of true places.

    Centre and slopes are jointly normal with the covariance -pivot lean^2, so the step of one carries the other. What
    is left of a centre's error is the kept share of its noise and the share not kept of its true scatter.
    """
    assert feature.center_mm is not None and feature.covariance_mm2 is not None
    own, every, scatter = variances
    share = scatter / (scatter + every)
    lean2 = np.radians(feature.axis_sigma_deg or 0.0) ** 2
    together = -feature.pivot_mm * lean2
    left = share**2 * own + (1.0 - share) ** 2 * scatter
    along = np.outer(normal, normal)
    kept = left * (np.eye(3) - along) + along @ feature.covariance_mm2 @ along
    centre = feature.center_mm - (1.0 - share) * miss
    if feature.axis is None or lean2 == 0.0:
        return replace(feature, center_mm=centre, covariance_mm2=kept)
    gain = together / (scatter + every)
    axis = feature.axis * np.sign(feature.axis @ normal) - gain * miss
    lean2_left = lean2 - gain * together
    return replace(
        feature,
        center_mm=centre,
        covariance_mm2=kept,
        axis=axis / np.linalg.norm(axis),
        axis_sigma_deg=float(np.degrees(np.sqrt(lean2_left))),
        pivot_mm=-share * together / lean2_left,
    )


def _places(part: PartMeasurement, angles_deg: tuple[float, ...]) -> Array:
    """(n, 3) where the fitted pattern puts the features, in the measurement's frame."""
    angle, radius = np.radians(angles_deg), 0.5 * part.circle_diameter_mm
    flat = np.column_stack([radius * np.cos(angle), radius * np.sin(angle), np.zeros(len(angle))])
    return np.asarray(flat @ part.T_frame_part[:3, :3].T + part.T_frame_part[:3, 3])


def _noise_mm2(feature: FeatureFit, across: Array) -> float:
    assert feature.covariance_mm2 is not None
    return 0.5 * float(np.trace(across.T @ feature.covariance_mm2 @ across))
