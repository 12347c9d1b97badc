"""What a measured pattern is believed to be: the drawing's positions hold within their tolerance. Pure.

A hole seen with 20 um of noise on a part whose holes are drilled to 10 um is more likely near its place in the pattern
than where it was seen. Without this the minimax polish would follow the noise of the worst measurement.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from cellctl.kinematics import Array
from cellctl.vision.part import FeatureFit, PartMeasurement


def believed(part: PartMeasurement, angles_deg: tuple[float, ...], sigma_mm: float) -> PartMeasurement:
    """The measurement with each centre drawn towards its place in the fitted pattern (normal prior, per axis).

    `angles_deg` are the pattern's angles in the part's own frame, `sigma_mm` the scatter that the drawing's position
    tolerance stands for. The scatter that the measurement itself shows beyond its own noise (method of moments) is
    used where it is larger: a part out of tolerance is believed to be so.
    """
    places = _places(part, angles_deg)
    across = part.T_frame_part[:3, :2]
    centres = np.array([feature.center_mm for feature in part.features])
    rest = (centres - places) @ across
    noise = np.array([_noise_mm2(feature, across) for feature in part.features])
    seen = 0.5 * float(np.mean(np.sum(rest * rest, axis=1))) - float(np.mean(noise))
    scatter = max(sigma_mm**2, seen)
    share = scatter / (scatter + noise)
    drawn = centres - ((1.0 - share)[:, None] * rest) @ across.T
    features = tuple(
        replace(feature, center_mm=centre, covariance_mm2=kept * feature.covariance_mm2)
        for feature, centre, kept in zip(part.features, drawn, share, strict=True)
    )
    return replace(part, features=features)


def _places(part: PartMeasurement, angles_deg: tuple[float, ...]) -> Array:
    """(n, 3) where the fitted pattern puts the features, in the measurement's frame."""
    angle, radius = np.radians(angles_deg), 0.5 * part.circle_diameter_mm
    flat = np.column_stack([radius * np.cos(angle), radius * np.sin(angle), np.zeros(len(angle))])
    return np.asarray(flat @ part.T_frame_part[:3, :3].T + part.T_frame_part[:3, 3])


def _noise_mm2(feature: FeatureFit, across: Array) -> float:
    assert feature.covariance_mm2 is not None
    return 0.5 * float(np.trace(across.T @ feature.covariance_mm2 @ across))
