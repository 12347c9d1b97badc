"""What speaks against this being the part of the recipe: sizes, places, a face closed where a feature should be.

One feature may be wrong on a right part and is reported; where more than a quarter are, the part is another one.
"""

from __future__ import annotations

import numpy as np

from cellctl.vision.columns import Columns
from cellctl.vision.geometry import Array, PlaneFrame
from cellctl.vision.part import FeatureFit, Part, Refused
from cellctl.vision.pattern import PatternFit

TOO_MANY, ROUGH_MM, BARE = 0.25, 0.1, 0.25
"""Share of the features that may speak against the part; how far the others may miss their places where one does;
share of a feature's middle that is covered where it is not there."""
SAMPLE, LEAST_WALLS = 100_000, 3


def check_hole_sizes(part: Part, radii_mm: Array, sigma_mm: float) -> None:
    """Refuse (wrong_part) holes whose walls (n,), NaN where not seen, are not as wide as drawn.

    A drilled hole is held to about ISO 286 H13: 0.15 mm and a hundredth of its diameter.
    """
    if part.diameter_mm is None or np.count_nonzero(np.isfinite(radii_mm)) < min(LEAST_WALLS, part.count):
        return
    drawn, seen = np.asarray(part.diameter_mm), np.isfinite(radii_mm)
    wrong = np.abs(2.0 * radii_mm - drawn) > 0.15 + 0.01 * drawn + 2.0 * sigma_mm
    if np.count_nonzero(wrong) > 0.5 * np.count_nonzero(seen):
        k = int(np.flatnonzero(wrong)[0])
        raise Refused(
            "wrong_part",
            f"{np.count_nonzero(wrong)} of {np.count_nonzero(seen)} holes have another size: number {k} measures "
            f"{2.0 * radii_mm[k]:.2f} mm across, the recipe says {drawn[k]:.2f} mm",
        )


def check_outlines(part: Part, features: tuple[FeatureFit, ...]) -> None:
    """Refuse (wrong_part) holes that are far from any size a core, a thread or a chamfered mouth would show."""
    if part.diameter_mm is None:
        return
    ratios = np.array([2.0 * f.radius_mm / part.diameter_mm[f.index] for f in features if f.radius_mm is not None])
    if len(ratios) and np.mean((ratios < 0.65) | (ratios > 1.45)) > TOO_MANY:
        raise Refused("wrong_part", f"the holes are {np.median(ratios):.2f} times as wide as the recipe says")


def off_place_mm(part: Part) -> float:
    """How far from its drawn place a feature may lie on a right part: beyond any positional tolerance of a joint."""
    return 0.4 + 5e-4 * part.circle_diameter_mm


def check_off_place(part: Part, strays: int) -> None:
    """Refuse (wrong_part) where too many features lie off their places."""
    if strays > TOO_MANY * part.count:
        raise Refused("wrong_part", f"{strays} of {part.count} features lie more than {off_place_mm(part):.2f} mm off")


def check_absent(
    part: Part, bare: frozenset[int], before: tuple[FeatureFit, ...], after: tuple[FeatureFit, ...], fitted: PatternFit
) -> None:
    """Refuse (wrong_part) where features are provably not at their places, and too many or the rest fits badly.

    `bare` are those at whose places the bare face is seen; those that the pattern does not rest on `after` all, though
    they were found `before`, lie off.
    """
    strays = frozenset(item.index for item in after if not item.found and before[item.index].found)
    against = bare | strays
    variances = [np.trace(item.covariance_mm2) for item in after if item.covariance_mm2 is not None]
    usual = float(np.sqrt(np.median(variances) / 2.0))
    rough = float(np.nanmedian(np.hypot(*fitted.residuals_mm.T)))  # a few torn holes say nothing about the part
    if len(against) > TOO_MANY * part.count or (against and rough > ROUGH_MM + 3.0 * usual):
        raise Refused(
            "wrong_part",
            f"{len(bare)} of {part.count} features are not there, {len(strays)} lie off their places and the others "
            f"miss theirs by {rough:.2f} mm",
        )


def bare_places(part: Part, lost: frozenset[int], scan: Columns, frame: PlaneFrame, radii_mm: Array,
                sigma_mm: float, spacing_mm: float) -> frozenset[int]:  # fmt: skip
    """Those of the `lost` features at whose places the bare face is seen.

    `frame` is the part's, `radii_mm` (n,) are those of the features at the face.
    """
    if not lost:
        return lost
    step = max(1, len(scan) // SAMPLE)
    some = scan.take(slice(None, None, step)).into(frame)
    some = some.take(np.abs(some.z) < 5.0 * sigma_mm)
    bare = set()
    for k in sorted(lost):
        angle, reach = np.radians(part.angles_deg[k]), 0.6 * float(radii_mm[k])
        u, v = 0.5 * part.circle_diameter_mm * np.array([np.cos(angle), np.sin(angle)])
        inside = int(np.count_nonzero(np.hypot(some.x - u, some.y - v) < reach))
        if inside >= max(2.0, BARE * np.pi * reach**2 / (step * spacing_mm**2)):
            bare.add(k)
    return frozenset(bare)
