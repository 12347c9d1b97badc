"""Holes on the face (eq. 19-20): each nominal place is looked at, every hole is found or reported missing.

Works in the part's approximate frame: origin at the pattern's centre on the face, u through its zero angle, w out.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from cellctl.vision import hole_fit, hole_model
from cellctl.vision.columns import Columns
from cellctl.vision.eye import over_holes
from cellctl.vision.geometry import Array
from cellctl.vision.hole_refine import refine
from cellctl.vision.outline import Outline, edge_band_mm, fit_outlines
from cellctl.vision.part import Part
from cellctl.vision.pattern import nominal
from cellctl.vision.rim import look
from cellctl.vision.shared_noise import SharedNoise

MIN_INNER_POINTS = 12
MIN_ARC = 0.5
MIN_TORN_ARC = 0.25  # where the other holes tell the radius and the shape of the edge
MIN_EDGE_POINTS = 12
MAX_FILL = 0.25
ROUGHER = 2.0  # residuals of a hole's model against those of the others that are still alike
LEAST_WALLS, SAME_PLACE = 3, 3.0  # how many walls, and how few sigmas of a shift, let walls and outlines be mixed


@dataclass(frozen=True, slots=True)
class Hole:
    """One hole in the face's coordinates: centre (2,) on the face, axis slopes (2,), `covariance` (4, 4) of both.

    `by` says what the centre rests on. Where it was not found, `reason` says why and the numbers are NaN.
    """

    found: bool
    centre_mm: Array
    slopes: Array
    radius_mm: float
    covariance: Array
    points: int
    residual_mm: float
    by: str = "model"
    reason: str = ""
    chamfer_radius_mm: float | None = None


def missing(reason: str) -> Hole:
    """A hole that was not found."""
    nothing = np.full(2, np.nan)
    return Hole(False, nothing, nothing, float("nan"), np.full((4, 4), np.nan), 0, float("nan"), "", reason)


def void_radii(part: Part) -> Array:
    """Radius (n,) of the void that each hole leaves in the face, as far as the recipe tells; NaN where unknown."""
    sizes = np.full(part.count, np.nan) if part.diameter_mm is None else np.asarray(part.diameter_mm, dtype=np.float64)
    if part.chamfer_diameter_mm is not None:
        sizes = np.fmax(sizes, part.chamfer_diameter_mm)
    return np.asarray(0.5 * sizes)


@dataclass(frozen=True, slots=True)
class Sight:
    """How the points were seen: pinhole (3,) in their frame, noise shared by neighbours; None where not known.

    `spacing_mm` and `sigma_mm` are the face's point spacing and noise.
    """

    spacing_mm: float
    sigma_mm: float
    eye: Array | None = None
    noise: SharedNoise | None = None


@dataclass(frozen=True, slots=True)
class _Around:
    """Points (M, 3) in the part's frame, sorted by hole: hole k owns `starts[k]:starts[k + 1]`; `owner` (M,), and the
    `pixels` (M, 2) they come from, None for an unorganised cloud."""

    points: Array
    starts: NDArray[np.intp]
    owner: NDArray[np.intp]
    pixels: Array | None

    def of(self, k: int) -> Array:
        """Points of hole `k`."""
        return self.points[self.starts[k] : self.starts[k + 1]]


def reaches(part: Part, radii_mm: Array) -> Array:
    """How far (n,) around each hole's nominal place its points are looked at, mm."""
    wide = 1.35 * radii_mm + 0.5 if part.chamfer_diameter_mm is not None else 1.6 * radii_mm + 0.6
    return np.asarray(np.minimum(wide, _half_gap(nominal(part))))


def measure_holes(
    near: Columns, owner: NDArray[np.intp], part: Part, radii_mm: Array, sight: Sight
) -> tuple[Hole, ...]:
    """All holes from points in the part's approximate frame, with the hole (M,) that each lies around; `radii_mm` (n,)
    are the voids' radii."""
    around = _gather(near, owner, part, radii_mm)
    if sight.eye is None:
        sight = replace(sight, eye=_eye(around, part, radii_mm))
    if part.chamfer_diameter_mm is not None:
        by_rim = _by_rim(around, part, radii_mm, sight)
    else:
        by_rim = _by_outline(around, part, radii_mm, sight)
    chosen = [k for k in range(part.count) if by_rim[k].found]
    modelled = _by_model(around, chosen, by_rim, part, sight)
    if part.chamfer_diameter_mm is None:
        return _together(by_rim, modelled, chosen, sight.spacing_mm)
    return _settled(by_rim, modelled, part, sight.spacing_mm)


def _gather(near: Columns, owner: NDArray[np.intp], part: Part, radii_mm: Array) -> _Around:
    """The points within reach of their hole, between its bottom and a little above the face."""
    centres = nominal(part)
    deepest = -(part.depth_mm or 3.0 * float(radii_mm.max())) - 1.0
    square = np.square(near.x - centres[owner, 0]) + np.square(near.y - centres[owner, 1])
    rows = np.flatnonzero((square < np.square(reaches(part, radii_mm))[owner]) & (near.z > deepest) & (near.z < 1.0))
    rows = rows[np.argsort(owner[rows].astype(np.int16), kind="stable")]
    pixels = None
    if near.pixels is not None:
        pixels = np.stack(np.divmod(near.pixels[rows], near.shape[1]), axis=1).astype(np.float64)
    starts = np.searchsorted(owner[rows], np.arange(part.count + 1))
    return _Around(near.take(rows).stacked(), starts, owner[rows], pixels)


def _eye(around: _Around, part: Part, radii_mm: Array) -> Array | None:
    """From where the points were seen, as the walls show it."""
    walls = radii_mm if part.diameter_mm is None else 0.5 * np.asarray(part.diameter_mm)
    slope = np.tan(np.radians(part.chamfer_angle_deg or 45.0))
    return over_holes(around.points, around.owner, nominal(part), walls, float((radii_mm - walls).max() / slope) + 0.3)


def _by_rim(around: _Around, part: Part, radii_mm: Array, sight: Sight) -> list[Hole]:
    """Every chamfered hole as its rim shows it: found with a place to start from, or missing with the reason."""
    centres = nominal(part)
    on = np.flatnonzero(np.abs(around.points[:, 2]) < 4.0 * sight.sigma_mm)
    rims = look(around.points[on, :2] - centres[around.owner[on]], around.owner[on], radii_mm, sight.spacing_mm)
    holes = []
    for k in range(part.count):
        seen = None
        if np.isfinite(rims.arc[k]):
            points = round(float(rims.arc[k]) * 2.0 * np.pi * float(rims.radius_mm[k]) / sight.spacing_mm)
            seen = Outline(
                centre_mm=centres[k] + rims.centre_mm[k], radius_mm=float(rims.radius_mm[k]),
                covariance=rims.covariance_mm2[k], scatter_mm=float(rims.scatter_mm[k]), arc=float(rims.arc[k]),
                fill=float(rims.fill[k]), points=points,
            )  # fmt: skip
        holes.append(_judged(seen, part, k, float(radii_mm[k]), centres[k]))
    return holes


def _by_outline(around: _Around, part: Part, radii_mm: Array, sight: Sight) -> list[Hole]:
    """Every hole without a chamfer as its outline shows it, or missing with the reason."""
    on = np.abs(around.points[:, 2]) < edge_band_mm(sight.sigma_mm, sight.spacing_mm)
    centres = nominal(part)
    outlines = fit_outlines(around.points[on, :2], around.owner[on], centres, radii_mm, sight.spacing_mm, part)
    return [_judged(outlines[k], part, k, float(radii_mm[k]), centres[k]) for k in range(part.count)]


def _judged(outline: Outline | None, part: Part, index: int, radius_mm: float, centre_mm: Array) -> Hole:
    least_arc = MIN_TORN_ARC if part.chamfer_diameter_mm is None else MIN_ARC
    reason = _why_missing(outline, centre_mm, radius_mm, least_arc)
    return missing(reason) if reason or outline is None else _from_outline(outline, radius_mm, part, index)


def _half_gap(centres: Array) -> float:
    """Half of the smallest distance between two nominal centres."""
    distance = np.hypot(*(centres[:, None] - centres[None]).transpose(2, 0, 1))
    return 0.5 * float(distance[distance > 1e-6].min())


def _why_missing(outline: Outline | None, nominal_mm: Array, radius_mm: float, least_arc: float) -> str:
    """Empty where the outline is that of a hole at its place, else why it is not."""
    if outline is not None and outline.fill > MAX_FILL:
        return "the face is closed at the hole's place"
    if outline is None or outline.arc == 0.0:
        return "no edge of the face was seen at the hole's place"
    if outline.arc < least_arc:
        return f"only {100 * outline.arc:.0f} % of the outline was seen"
    if outline.points < MIN_EDGE_POINTS:
        return f"only {outline.points} points lie along the outline"
    # half of an outline says where a hole is: one in a wrong place is found there, and speaks against the part
    if outline.arc < MIN_ARC and np.hypot(*(outline.centre_mm - nominal_mm)) > 0.5 * radius_mm:
        return "the void found lies off the hole's place"
    if not 0.6 * radius_mm < outline.radius_mm < 1.5 * radius_mm:
        return f"the void found has radius {outline.radius_mm:.2f} mm instead of {radius_mm:.2f} mm"
    return ""


def _from_outline(outline: Outline, radius_mm: float, part: Part, index: int) -> Hole:
    """The hole that an outline shows. With a chamfer the outline is its mouth: the drawn difference is taken off."""
    mouth = radius_mm - 0.5 * part.diameter_mm[index] if part.chamfer_diameter_mm and part.diameter_mm else 0.0
    covariance = np.zeros((4, 4))
    covariance[:2, :2] = outline.covariance
    covariance[2:, 2:] = np.eye(2) * hole_fit.TILT_PRIOR_RAD**2
    return Hole(True, outline.centre_mm, np.zeros(2), outline.radius_mm - mouth, covariance, outline.points,
                outline.scatter_mm, "outline")  # fmt: skip


def _by_model(around: _Around, chosen: list[int], outlines: list[Hole], part: Part, sight: Sight) -> dict[int, Hole]:
    """Joint fit of face, chamfer and wall of the chosen holes, by hole number."""
    if not chosen:
        return {}
    origins = np.stack([np.append(outlines[k].centre_mm, 0.0) for k in chosen])
    counts = np.diff(around.starts)[chosen]
    rows = np.concatenate([np.arange(around.starts[k], around.starts[k + 1]) for k in chosen])
    samples = hole_model.Samples.of(
        around.points[rows] - np.repeat(origins, counts, axis=0),
        np.append(0, np.cumsum(counts)),
        None if sight.eye is None else sight.eye - origins,
        slope=float(np.tan(np.radians(part.chamfer_angle_deg or 45.0))),
        depth_mm=part.depth_mm or float("inf"),
        chamfered=part.chamfer_diameter_mm is not None,
    )
    start = np.zeros((len(chosen), hole_model.SIZE))
    for row, k in enumerate(chosen):
        wall = outlines[k].radius_mm if part.diameter_mm is None else 0.5 * part.diameter_mm[k]
        chamfer = max(wall, 0.5 * part.chamfer_diameter_mm) if part.chamfer_diameter_mm else wall
        start[row, hole_model.WALL], start[row, hole_model.CHAMFER] = wall, chamfer
    fits = hole_fit.fit(samples, start, sight.sigma_mm)
    if sight.noise is not None and around.pixels is not None and sight.eye is not None:
        fits = refine(samples, fits, sight.noise, around.pixels[rows], sight.spacing_mm)
    holes = {k: _from_model(fits, row, origins[row], samples.chamfered) for row, k in enumerate(chosen)}
    return {k: hole for k, hole in holes.items() if hole is not None}


def _from_model(fits: hole_fit.HoleFits, row: int, origin: Array, chamfered: bool) -> Hole | None:
    """The hole of one row, None where too few points of chamfer and wall carry it."""
    inner = int(fits.counts[row, hole_model.CONE] + fits.counts[row, hole_model.CYLINDER])
    if inner < MIN_INNER_POINTS:
        return None
    p = fits.parameters[row]
    chosen = [hole_model.CU, hole_model.CV, hole_model.TILT_U, hole_model.TILT_V]
    covariance = fits.covariances[row][np.ix_(chosen, chosen)]
    slopes = p[[hole_model.TILT_U, hole_model.TILT_V]]
    return Hole(True, origin[:2] + p[:2], slopes, float(p[hole_model.WALL]), covariance,
                int(fits.counts[row].sum()), float(fits.residual_mm[row]), "model",
                chamfer_radius_mm=float(p[hole_model.CHAMFER]) if chamfered else None)  # fmt: skip


def _better(model: Hole, outline: Hole, spacing_mm: float) -> bool:
    """The model carries the hole where it is the surer of the two and does not contradict the outline."""
    apart = float(np.hypot(*(model.centre_mm - outline.centre_mm)))
    spread = float(np.sqrt(np.trace(outline.covariance[:2, :2])))
    surer = float(np.trace(model.covariance[:2, :2])) < float(np.trace(outline.covariance[:2, :2]))
    return surer and apart < 6.0 * spread + 0.5 * spacing_mm


def _together(rims: list[Hole], modelled: dict[int, Hole], found: list[int], spacing_mm: float) -> tuple[Hole, ...]:
    """Holes without a chamfer by their walls or by their outlines, not mixed where these put the part elsewhere.

    An edge is worn on one side, alike at every hole: what walls and outlines say together would mix two places.
    """
    walls = {k: modelled[k] for k in found if k in modelled and _better(modelled[k], rims[k], spacing_mm)}
    if len(walls) == len(found):
        return tuple(walls.get(k, hole) for k, hole in enumerate(rims))
    if len(walls) < LEAST_WALLS:
        return tuple(rims)
    shift = np.mean([hole.centre_mm - rims[k].centre_mm for k, hole in walls.items()], axis=0)
    spread = np.mean([np.trace(rims[k].covariance[:2, :2]) for k in walls]) / len(walls)
    agree = float(shift @ shift) < SAME_PLACE**2 * spread
    return tuple(walls.get(k, hole) if agree else hole for k, hole in enumerate(rims))


def _settled(rims: list[Hole], modelled: dict[int, Hole], part: Part, spacing_mm: float) -> tuple[Hole, ...]:
    """The chamfered holes by model or rim, or missing where these contradict each other or the other holes.

    The edge of a patch without points passes for a piece of a rim: what is torn gets another size and place than the
    other rims have. A model is believed against its rim where it fits as the other models do.
    """
    drawn = np.zeros(part.count) if part.diameter_mm is None else 0.5 * np.asarray(part.diameter_mm)
    found = [k for k, hole in enumerate(rims) if hole.found]
    wide = float(np.median([rims[k].radius_mm - drawn[k] for k in found])) if found else 0.0
    usual = float(np.median([hole.residual_mm for hole in modelled.values()])) if modelled else 0.0
    holes = list(rims)
    for k in found:
        model, off = modelled.get(k), rims[k].radius_mm - drawn[k] - wide
        if model is not None and _better(model, rims[k], spacing_mm):
            holes[k] = model
        elif model is not None and float(np.hypot(*(model.centre_mm - rims[k].centre_mm))) > spacing_mm:
            fits = model.residual_mm < ROUGHER * usual
            holes[k] = model if fits else missing("its rim and its chamfer and wall contradict each other")
        elif abs(off) > spacing_mm:
            holes[k] = missing(f"its rim is torn: it seems {2.0 * off:+.2f} mm wider than those of the other holes")
    return tuple(holes)
