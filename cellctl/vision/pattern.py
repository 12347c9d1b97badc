"""The bolt pattern in the plane: found among candidates without any prior pose, then fitted to the measured centres."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from itertools import product

import numpy as np
from numpy.typing import NDArray

from cellctl.vision.geometry import Array, rotate, row_medians, wrap_rad
from cellctl.vision.part import Part, Refused

# score by which the best clocking must beat every other one; one matched feature is worth 1
CLEAR_MARGIN = 0.2
CENTRES = 3  # centres that are tried
FAR = 3.0  # squared distance in sigmas from which on a centre loses weight: one in five goes farther by chance alone
STILL = 1e-7  # mm, rad, and share of a variance
CONSISTENT = 1.193  # variance of normal centres over the one that those weights show: 2 W / E[min(chi2, FAR)]


@dataclass(frozen=True, slots=True)
class PatternPose:
    """Pattern centre (2,) mm in plane coordinates and clocking (rad); how many features were matched, and how well."""

    centre_mm: Array
    clocking_rad: float
    matched: int
    score: float


@dataclass(frozen=True, slots=True)
class PatternFit:
    """Least-squares pose of the pattern: centre (2,), clocking, `covariance` (3, 3) of x, y (mm2), clocking (rad2).

    `diameter_mm` is the circle's, known to `sigma_diameter_mm`; `residuals_mm` (n, 2) measured minus fitted, NaN where
    a feature is missing.
    """

    centre_mm: Array
    clocking_rad: float
    covariance: Array
    diameter_mm: float
    sigma_diameter_mm: float
    residuals_mm: Array


def nominal(part: Part) -> Array:
    """Nominal centres (n, 2) in the part frame, mm."""
    angles = np.radians(part.angles_deg)
    return np.asarray(0.5 * part.circle_diameter_mm * np.column_stack([np.cos(angles), np.sin(angles)]))


def placed(part: Part, pose: PatternPose | PatternFit) -> Array:
    """Nominal centres (n, 2) in the plane's coordinates, mm."""
    return np.asarray(pose.centre_mm + rotate(nominal(part), pose.clocking_rad))


def symmetry(part: Part) -> int:
    """Order of the pattern's own rotational symmetry, 1 where clocking is fixed by angles or diameters."""
    angles = np.mod(np.asarray(part.angles_deg), 360.0)
    sizes = np.asarray(part.diameter_mm if part.diameter_mm else np.zeros(part.count))
    for order in range(part.count, 1, -1):
        if part.count % order:
            continue
        turned = np.mod(angles + 360.0 / order, 360.0)
        gap = np.abs(np.mod(turned[:, None] - angles[None] + 180.0, 360.0) - 180.0)
        partner = gap.argmin(axis=1)
        same_size = np.abs(sizes[partner] - sizes) < 0.02 * max(float(sizes.max()), 1e-9) + 1e-9
        if gap.min(axis=1).max() < 1e-3 and same_size.all():
            return order
    return 1


def blind_to_sizes(part: Part) -> Part:
    """The part with its sizes made alike, or the part itself where places and sizes have the same symmetry."""
    if (
        part.feature != "hole"
        or part.diameter_mm is None
        or symmetry(replace(part, diameter_mm=None)) == symmetry(part)
    ):
        return part
    if part.chamfer_diameter_mm is None:
        return replace(part, diameter_mm=None)
    return replace(part, diameter_mm=(float(np.median(part.diameter_mm)),) * part.count)


def find_pattern(part: Part, positions: Array, radii: Array, weights: Array, tolerance_mm: float) -> PatternPose | None:
    """The pose of `find_patterns` that explains the candidates best, None where there is none.

    Raises Refused pattern_ambiguous where two clockings that the pattern's symmetry does not explain are met equally
    well.
    """
    poses = find_patterns(part, positions, radii, weights, tolerance_mm, within=CLEAR_MARGIN)
    if len(poses) > 1 and 2 * poses[0].matched >= part.count:
        raise Refused("pattern_ambiguous", "two clockings of the pattern are met equally well")
    return poses[0] if poses else None


def find_patterns(
    part: Part, positions: Array, radii: Array, weights: Array, tolerance_mm: float, *, within: float
) -> list[PatternPose]:
    """Poses of the pattern among candidates (n, 2) with radii (n,) and weights (n,) that score up to `within` less than
    the best one, best first; empty where fewer than three features are met.

    The centre by voting of pairs of candidates on the known circle, the clocking by voting of all pairings with the
    nominal angles.
    """
    step = 2.0 * np.pi / symmetry(part)
    poses: list[PatternPose] = []
    for centre in _vote_centres(positions, weights, 0.5 * part.circle_diameter_mm, tolerance_mm):
        poses += _vote_clockings(part, positions - centre, radii, weights, tolerance_mm, centre, step, within)
    poses.sort(key=lambda pose: -pose.score)
    near = 2.0 * tolerance_mm, 8.0 * tolerance_mm / part.circle_diameter_mm
    kept: list[PatternPose] = []
    for pose in poses:
        if pose.score > poses[0].score - within and not any(_same(pose, other, step, *near) for other in kept):
            kept.append(pose)
    return kept


def _same(pose: PatternPose, other: PatternPose, step_rad: float, moved_mm: float, turned_rad: float) -> bool:
    """Whether two poses are one within a motion and a turn, or by the pattern's own symmetry (`step_rad`)."""
    turned = abs(math.remainder(pose.clocking_rad - other.clocking_rad, step_rad))
    return turned < turned_rad and math.dist(pose.centre_mm, other.centre_mm) < moved_mm


def _vote_centres(positions: Array, weights: Array, radius: float, tolerance_mm: float) -> list[Array]:
    """Up to `CENTRES` centres of the known circle, the one that most pairs of candidates vote for first."""
    first, second = np.triu_indices(len(positions), k=1)
    chord = positions[second] - positions[first]
    length = np.hypot(*chord.T)
    usable = (length > 0.4 * radius) & (length < 2.0 * radius + tolerance_mm)
    if not usable.any():
        return []
    first, second, chord, length = first[usable], second[usable], chord[usable], length[usable]
    height = np.sqrt(np.maximum(radius**2 - 0.25 * length**2, 0.0))
    normal = np.column_stack([-chord[:, 1], chord[:, 0]]) / length[:, None]
    middle = 0.5 * (positions[first] + positions[second])
    votes = np.concatenate([middle + normal * height[:, None], middle - normal * height[:, None]])
    value = np.tile(weights[first] * weights[second], 2)
    bin_mm = 2.0 * tolerance_mm
    cells = np.floor(votes / bin_mm).astype(np.int64)
    cells -= cells.min(axis=0)
    table = np.zeros(cells.max(axis=0) + 3)
    np.add.at(table, (cells[:, 0] + 1, cells[:, 1] + 1), value)
    smooth = np.zeros_like(table)
    for i, j in product((-1, 0, 1), repeat=2):
        smooth += np.roll(table, (i, j), axis=(0, 1))
    centres: list[Array] = []
    most = float(np.max(smooth))
    for _ in range(CENTRES):
        peak = np.array(np.unravel_index(int(np.argmax(smooth)), table.shape)) - 1
        if smooth[peak[0] + 1, peak[1] + 1] < 0.3 * most:
            break
        near = (np.abs(cells - peak) <= 1).all(axis=1)
        centre = _on_circle(np.average(votes[near], axis=0, weights=value[near]), positions, radius, tolerance_mm)
        if centre is not None:
            centres.append(centre)
        low = np.maximum(peak - 1, 0)
        smooth[low[0] : peak[0] + 4, low[1] : peak[1] + 4] = 0.0
    return centres


def _on_circle(centre: Array, positions: Array, radius: float, tolerance_mm: float) -> Array | None:
    """Least squares of the centre on the known circle through the candidates near it, None with fewer than three."""
    for _ in range(10):
        offset = positions - centre
        rho = np.hypot(*offset.T)
        on = np.abs(rho - radius) < 2.0 * tolerance_mm
        if np.count_nonzero(on) < 3:
            return None
        direction = offset[on] / rho[on, None]
        centre = centre + np.linalg.lstsq(direction, rho[on] - radius, rcond=None)[0]
    return centre


def _vote_clockings(
    part: Part, offset: Array, radii: Array, weights: Array, tolerance_mm: float, centre: Array, step: float,
    within: float,
) -> list[PatternPose]:  # fmt: skip
    """Poses about one centre that meet at least three features and score up to `within` less than the best one, each
    the best within its own tolerance. Clockings that differ by `step` are one: the one nearest to zero stands for all.
    """
    radius = 0.5 * part.circle_diameter_mm
    on = np.abs(np.hypot(*offset.T) - radius) < 2.0 * tolerance_mm
    if np.count_nonzero(on) < 3:
        return []
    angles, tolerance = np.arctan2(offset[on, 1], offset[on, 0]), 2.0 * tolerance_mm / radius
    differences = np.mod(angles[:, None] - np.radians(part.angles_deg), step)
    bins = np.unique(np.round(differences / (0.5 * tolerance)).astype(np.int64))
    clockings, matched, scores = _scores(part, bins * 0.5 * tolerance, angles, radii[on], weights[on], tolerance)
    kept: list[PatternPose] = []
    for k in np.argsort(-scores, kind="stable").tolist():
        if scores[k] <= scores.max() - within:
            break
        turn = float(clockings[k])
        if all(abs(math.remainder(turn - other.clocking_rad, step)) > 2.0 * tolerance for other in kept):
            kept.append(PatternPose(centre, turn, int(matched[k]), float(scores[k])))
    poses = []
    for item in kept:
        clocking = math.remainder(item.clocking_rad, step)
        shift, turn = _rigid(nominal(part), offset[on], clocking, tolerance * radius)
        poses.append(PatternPose(centre + shift, clocking + turn, item.matched, item.score))
    return poses


def _rigid(model: Array, offset: Array, clocking: float, tolerance_mm: float) -> tuple[Array, float]:
    """Small shift (2,) and turn that bring the pattern onto the candidates that it meets."""
    turned = rotate(model, clocking)
    gap = offset[:, None] - turned[None]
    distance = np.hypot(gap[..., 0], gap[..., 1])
    nearest = distance.argmin(axis=0)
    index = np.arange(len(model))
    met = distance[nearest, index] < tolerance_mm
    if np.count_nonzero(met) < 2:
        return np.zeros(2), 0.0
    residual, arm = gap[nearest, index][met], turned[met]
    design = np.zeros((len(arm), 2, 3))
    design[:, 0, 0] = design[:, 1, 1] = 1.0
    design[:, 0, 2], design[:, 1, 2] = -arm[:, 1], arm[:, 0]
    answer = np.linalg.lstsq(design.reshape(-1, 3), residual.reshape(-1), rcond=None)[0]
    return answer[:2], float(answer[2])


def _scores(
    part: Part, thetas: Array, angles: Array, sizes: Array, value: Array, tolerance: float
) -> tuple[Array, NDArray[np.intp], Array]:
    """Trial clockings (t,) that meet at least three candidates, each moved to where it leads; features matched (t,);
    scores (t,): one a matched feature, less where sizes disagree."""
    order = np.argsort(angles, kind="stable")
    around = np.concatenate([order[-1:], order, order[:1]])
    ring = angles[around] + 2.0 * np.pi * np.array([-1.0, *np.zeros(len(order)), 1.0])
    wanted = wrap_rad(thetas[:, None] + np.radians(part.angles_deg))
    nearest = np.searchsorted(0.5 * (ring[1:] + ring[:-1]), wanted)
    miss, candidate = ring[nearest] - wanted, around[nearest]
    matched = np.abs(miss) < tolerance
    met = matched.sum(axis=1) >= 3
    thetas, miss, candidate, matched = thetas[met], miss[met], candidate[met], matched[met]
    weight = np.where(matched, value[candidate], 0.0)
    shift = (weight * miss).sum(axis=1) / weight.sum(axis=1)
    miss = miss - shift[:, None]  # a trial clocking stands for the one it leads to
    worth = np.minimum(weight / np.quantile(value, 0.75), 1.0)
    scores = (worth * (1.0 - 0.3 * (miss / tolerance) ** 2)).sum(axis=1)
    if part.diameter_mm is not None:
        ratio = np.where(matched, np.log(2.0 * sizes[candidate] / np.asarray(part.diameter_mm)), np.nan)
        # only differences between features count: a chamfer makes all voids larger alike
        scores -= np.nansum(np.minimum(np.abs(ratio - row_medians(ratio)[:, None]), 0.5), axis=1)
    return thetas + shift, matched.sum(axis=1), scores


def fit_pattern(part: Part, centres: Array, covariances: Array, clocking_rad: float) -> PatternFit:
    """Robust rigid least squares of the nominal pattern on centres (n, 2), NaN where missing.

    `covariances` (n, 2, 2) are type A: a centre counts little along the direction in which it is unsure. What the
    residuals scatter beyond them is added to all alike (true holes are not where the drawing says), and one that still
    lies far off loses weight, so that a torn hole does not turn the rest. A scatter that few residuals show makes
    Student's t of the pose's error, whose variance is larger. Raises Refused features_missing below three.
    """
    found = np.isfinite(centres).all(axis=1)
    if np.count_nonzero(found) < 3:
        raise Refused("features_missing", f"{int(found.sum())} features found, at least 3 are needed")
    model, measured, own = nominal(part)[found], centres[found], covariances[found]
    alone = np.linalg.inv(own)
    pose = np.array([*(measured - model).mean(axis=0), clocking_rad])
    degrees = 2 * len(model) - 3
    extra, free = 0.0, degrees / (2.0 * len(model))
    for _ in range(30):
        turned = rotate(model, float(pose[2]))
        residual = measured - turned - pose[:2]
        precision = np.linalg.inv(own + extra * np.eye(2))
        trust = FAR / np.maximum(np.einsum("ni,nij,nj->n", residual, precision, residual), FAR)
        design = np.zeros((len(model), 2, 4))  # x, y, turn, and outward for the diameter
        design[:, 0, 0] = design[:, 1, 1] = 1.0
        design[:, 0, 2], design[:, 1, 2] = -turned[:, 1], turned[:, 0]
        design[:, :, 3] = turned / np.hypot(*turned.T)[:, None]
        weighted = (precision * trust[:, None, None]) @ design
        matrix = np.einsum("nij,nik->jk", weighted, design)
        pull = np.einsum("nij,ni->j", weighted, residual)
        step, before = np.linalg.solve(matrix[:3, :3], pull[:3]), extra
        pose = pose + step
        # variance of true positions by moments (DerSimonian-Laird), so that chi-square meets its expectation
        shown = CONSISTENT * float(np.einsum("n,ni,nij,nj->", trust, residual, alone, residual)) / free
        extra = max(0.0, (shown - 2.0 * float(trust.sum())) / float(np.einsum("n,nii->", trust, alone)))
        if np.abs(step).max() < STILL and abs(extra - before) <= STILL * (extra + before):
            break
    learnt = extra / (extra + 0.5 * float(np.mean(np.trace(own, axis1=1, axis2=2))))
    wider = 1.0 + 2.0 * learnt / (degrees - 2)  # t with f degrees of freedom: variance f / (f - 2)
    everything = np.full((part.count, 2), np.nan)
    everything[found] = residual
    return PatternFit(
        centre_mm=pose[:2],
        clocking_rad=float(wrap_rad(pose[2:])[0]),
        covariance=wider * np.linalg.inv(matrix[:3, :3]),
        diameter_mm=part.circle_diameter_mm + 2.0 * float(np.linalg.solve(matrix, pull)[3]),
        sigma_diameter_mm=2.0 * float(np.sqrt(wider * np.linalg.inv(matrix)[3, 3])),
        residuals_mm=everything,
    )
