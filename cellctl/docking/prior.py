"""What a measured pattern is believed to be: the drawing's positions hold within their tolerance. Pure.

A hole seen with 20 um of noise on a part whose holes are drilled to 10 um is more likely near its place in the pattern
than where it was seen. Without this the minimax polish would follow the noise of the worst measurement.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from cellctl.docking.ripple import RippleNoise
from cellctl.kinematics import Array
from cellctl.vision.part import FeatureFit, PartMeasurement

SHARES = (np.arange(200) + 0.5) / 200.0
"""Shares of a spread among which the split between noise and true scatter is looked for."""


@dataclass(frozen=True, slots=True)
class Believed:
    """A part as it is believed to be, how much (n,) is kept of what each centre was seen off its place, and the
    variance (n,) per axis of each centre's own noise, as the pattern shows it."""

    part: PartMeasurement
    share: Array
    noise_mm2: Array


def believed(part: PartMeasurement, angles_deg: tuple[float, ...], sigma_mm: float, ripple: RippleNoise) -> Believed:
    """The measurement with each centre drawn towards its place in the fitted pattern (normal prior, per axis).

    `angles_deg` are the pattern's angles in the part's own frame, `sigma_mm` the scatter that the drawing's position
    tolerance stands for. Where centres clearly scatter by more than their noise, the scanner's `ripple` and that
    scatter together (by more than one standard error), `_shared_out` says which of them is larger than stated: a part
    out of tolerance is believed to be so. A lean that goes with the error of the centre is corrected along with it.
    """
    places = _places(part, angles_deg)
    across = part.T_frame_part[:3, :2]
    centres = np.array([feature.center_mm for feature in part.features])
    rest = (centres - places) @ across
    noise = np.array([_noise_mm2(feature, across) for feature in part.features]) + ripple.own_mm2
    # centre, clocking and diameter of the pattern were fitted to the same centres
    free = max(rest.size - 4, 1)
    spread = float(np.sum(rest * rest)) / free * (1.0 - np.sqrt(2.0 / free))
    louder, scatter = _shared_out(spread - float(np.mean(ripple.waves_mm2)), float(np.mean(noise)), sigma_mm**2)
    noise = louder * noise
    total = noise + ripple.waves_mm2
    features = tuple(
        _drawn(feature, part.face.normal, across @ miss, (own, every, scatter))
        for feature, miss, own, every in zip(part.features, rest, noise, total, strict=True)
    )
    return Believed(replace(part, features=features), scatter / (scatter + total), noise)


def _shared_out(spread: float, noise: float, scatter: float) -> tuple[float, float]:
    """Factor on the noise variance and scatter (mm2) that explain `spread` (mm2) where noise and scatter do not.

    Both are known to about the same factor, so the pair that needs the smallest changes of their logarithms is taken:
    what makes up most of the spread is what was misjudged.
    """
    if spread <= noise + scatter or noise <= 0.0:
        return 1.0, max(scatter, spread - noise)
    parts = spread * SHARES
    change = np.log(parts / scatter) ** 2 + np.log((spread - parts) / noise) ** 2
    best = parts[np.argmin(change)]
    return float((spread - best) / noise), float(best)


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
