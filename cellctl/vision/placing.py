"""Where the features put the pattern: which of them it rests on, and whether that is known well enough to be a pose."""

from __future__ import annotations

import numpy as np

from cellctl.vision.contradictions import check_off_place, off_place_mm
from cellctl.vision.geometry import Array, PlaneFrame
from cellctl.vision.part import FeatureFit, Part, Refused
from cellctl.vision.pattern import PatternFit, fit_pattern

Features = tuple[FeatureFit, ...]
MAX_SIGMA_MM = 0.2
"""One sigma of the pattern's place, or of its turn along the circle, beyond which there is no pose."""


def well_seen(features: Features, least: int) -> Features:
    """The features, those that show fewer than `least` points counted as not found.

    Raises Refused too_few_points where that is more than half of them.
    """
    poor = {feature.index: feature.points for feature in features if feature.found and feature.points < least}
    if 2 * len(poor) > sum(feature.found for feature in features):
        worst = min(poor.values())
        raise Refused("too_few_points", f"a feature shows {worst} points, at least {least} are needed")
    return tuple(
        FeatureFit(item.index, False, points=item.points, reason=f"only {item.points} of {least} points were seen")
        if item.index in poor else item
        for item in features
    )  # fmt: skip


def centres_on(features: Features, frame: PlaneFrame, part: Part) -> Array:
    """Where the features' axes meet the face (n, 2), NaN where missing."""
    centres = np.full((part.count, 2), np.nan)
    for feature in features:
        if feature.center_mm is not None:
            centres[feature.index] = frame.into(feature.center_mm)[:2]
    return centres


def place_pattern(features: Features, frame: PlaneFrame, part: Part) -> tuple[PatternFit, Features]:
    """Least squares of the nominal pattern on the centres, in the plane of the face, and the features it rests on.

    A feature that lies farther off its place than any drawing allows is none of the pattern's: the worst is left out
    until none is left. Raises Refused wrong_part where too many are.
    """
    centres, covariances = centres_on(features, frame, part), np.tile(np.eye(2), (part.count, 1, 1))
    for feature in features:
        if feature.covariance_mm2 is not None:
            covariances[feature.index] = (frame.axes @ feature.covariance_mm2 @ frame.axes.T)[:2, :2]
    allowed = off_place_mm(part) + 5.0 * np.sqrt(np.trace(covariances, axis1=1, axis2=2))
    kept = list(features)
    while True:
        fitted = fit_pattern(part, centres, covariances, 0.0)
        miss = np.nan_to_num(np.hypot(*fitted.residuals_mm.T))
        worst = int(np.argmax(miss - allowed))
        if miss[worst] <= allowed[worst]:
            break
        centres[worst] = np.nan
        kept[worst] = FeatureFit(worst, False, reason=f"it lies {miss[worst]:.2f} mm off its place")
        check_off_place(part, int(np.isnan(centres[:, 0]).sum()) - sum(not feature.found for feature in features))
    if abs(fitted.diameter_mm - part.circle_diameter_mm) > 0.02 * part.circle_diameter_mm:
        raise Refused("wrong_part", f"the features lie on a circle of {fitted.diameter_mm:.2f} mm")
    return fitted, tuple(kept)


def check_known(fitted: PatternFit, spacing_mm: float, sigma_mm: float) -> None:
    """A place that is known to a fraction of a millimetre at best serves no joint. Raises Refused."""
    place = float(np.sqrt(np.trace(fitted.covariance[:2, :2])))
    turn = 0.5 * fitted.diameter_mm * float(np.sqrt(fitted.covariance[2, 2]))
    if max(place, turn) > MAX_SIGMA_MM:
        raise Refused(
            "too_coarse",
            f"the pattern is known to {max(place, turn):.2f} mm only, {MAX_SIGMA_MM:g} mm are allowed; "
            f"points lie {spacing_mm:.2f} mm apart and scatter by {sigma_mm:.2f} mm",
        )
