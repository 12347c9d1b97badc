"""The narrowest band that holds all points: the least range of a model's signed distances.

It has many local optima. From the lowest least-squares minima and places about them, ever higher powers of the
distances lead near the lowest bands, and successive linear programmes within a trust region end there: at the
solution the programme finds nothing to gain, so it says itself that it has arrived.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import partial

import numpy as np
from scipy.optimize import linprog

from cellctl.vision.fit.result import Array, FitError
from cellctl.vision.fit.search import Shape, candidates, distinct, sample, upright
from cellctl.vision.fit.solve import EPS, Model, descend, determined

POWERS = (2, 4, 8, 16)
ROUNDS = 8
AGAIN, BESIDE = 3, 16
"""How often, and from how many places, bands beside the narrowest one are looked for."""
HOPE = 1.5
"""Bands to which the powers led and that are wider than the best one by more cannot become narrower: the last power is
nearly the largest distance."""


@dataclass(frozen=True, slots=True)
class Band:
    """A narrowest band: frame (rows), parameters (p,) with the last one half way between the bounds, distances (n,)
    from there, Jacobian (n, p), linear programmes and why they ended."""

    frame: Array
    parameters: Array
    residuals: Array
    jacobian: Array
    rounds: int
    stopped: str

    @property
    def width(self) -> float:
        """Between the bounds."""
        return float(np.ptp(self.residuals))


def narrowest(shape: Shape, local: Array, flat: float) -> Band:
    """The narrowest band about points (n, 2) or (n, 3) of order one.

    Raises FitError where the band could be moved or where it is no narrower than the `flat` one of infinite radius.
    """
    with np.errstate(all="ignore"):  # candidates far off may overflow and are dropped
        best = _best(shape.model, local, _starts(shape, local), None, HOPE)
        for _ in range(AGAIN):
            better = (
                None if best is None else _best(shape.model, local, _beside(shape.model, local, best), best, np.inf)
            )
            if better is None or better is best:
                break
            best = better
    if best is None or best.stopped != "converged":
        raise FitError(f"the points do not determine a {shape.name}: no narrowest band was found")
    if not determined(best.jacobian) or best.width >= flat * (1.0 - 1e-6):
        raise FitError(f"the points do not determine a {shape.name}: a band moved or flattened is no wider")
    return best


def _best(model: Model, local: Array, starts: list[tuple[Array, Array]], best: Band | None, hope: float) -> Band | None:
    """The narrowest of `best` and the bands to which the starts (frame, parameters) lead that are less than `hope`
    times as wide."""
    for frame, start in starts:
        points = local @ frame.T
        if best is None or np.ptp(model(points, start)[0]) < hope * best.width:
            band = _programmes(model, points, frame, start)
            best = band if best is None or band.width < best.width * (1.0 - 1e-9) else best
    return best


def _beside(model: Model, local: Array, band: Band) -> list[tuple[Array, Array]]:
    """Starts about a band, the narrowest first: other bands may lie so near that the powers pass them over."""
    points = local @ band.frame.T
    _, x = _about(model, points, band.frame, band.parameters)
    spans = np.ptp(model(np.broadcast_to(points, (len(x), *points.shape)), x)[0], axis=1)
    return [(band.frame, x[k]) for k in np.argsort(spans, kind="stable")[1 : BESIDE + 1]]


def _starts(shape: Shape, local: Array) -> list[tuple[Array, Array]]:
    """Frames and parameters near the lowest bands, the lowest first."""
    points = sample(local)
    placed = [_about(shape.model, points @ frame.T, frame, x) for frame, x in candidates(shape, local)]
    if not placed:
        return []
    frames, x = np.concatenate([frames for frames, _ in placed]), np.concatenate([x for _, x in placed])
    for power in POWERS:
        turned = points @ np.swapaxes(frames, 1, 2)
        widest = np.abs(shape.model(turned, x)[0]).max(axis=1)
        x, _ = descend(partial(_raised, shape.model, power, widest), turned, x, ROUNDS)
        frames, x = upright(shape, frames, x)
    spans = np.ptp(shape.model(points @ np.swapaxes(frames, 1, 2), x)[0], axis=1)
    return distinct(shape, points, frames, x, spans)


def _about(model: Model, points: Array, frame: Array, x: Array) -> tuple[Array, Array]:
    """Frames (b, 3, 3) and parameters (b, p): `x` and steps from it that change the distances by half of the largest.

    The last parameter, the offset common to all distances, is left to the descent.
    """
    residuals, jacobian = model(points, x)
    _, values, rows = np.linalg.svd(jacobian[:, :-1] - jacobian[:, :-1].mean(axis=0), full_matrices=False)
    size = 0.5 * np.sqrt(len(points)) * np.abs(residuals).max() / np.maximum(values, 1e-12)
    signs = np.stack(np.meshgrid(*[[-1.0, 0.0, 1.0]] * len(size), indexing="ij"), axis=-1).reshape(-1, len(size))
    steps = (signs * size) @ rows
    steps /= np.maximum(1.0, np.abs(steps / (0.5 + 0.5 * np.abs(x[:-1]))).max(axis=1, keepdims=True))
    return np.broadcast_to(frame, (len(steps), *frame.shape)), x + np.pad(steps, ((0, 0), (0, 1)))


def _raised(model: Model, power: int, widest: Array, points: Array, x: Array) -> tuple[Array, Array]:
    """Distances over the widest of them, raised to half of `power`."""
    residuals, jacobian = model(points, x)
    ratio = residuals / widest[:, None]
    lower = np.abs(ratio) ** (power / 2 - 1)
    return ratio * lower, (0.5 * power * lower / widest[:, None])[..., None] * jacobian


def _programmes(model: Model, points: Array, frame: Array, start: Array, *, limit: int = 200) -> Band:
    """The band near `start`: each round minimises the span of the linearised distances within a box, which grows when
    the model was right and shrinks when it was not."""
    x, stopped, ended = start.copy(), "limit", limit
    values, jacobian = model(points, x)
    span = float(np.ptp(values))
    radius = 2.0 * span + 1e-9
    for rounds in range(limit):
        rounding = 8.0 * EPS * (1.0 + float(np.abs(x).max()))
        step, predicted = _programme(values, jacobian[:, :-1], radius, max(span, rounding))
        gain = span - predicted
        if not np.isfinite(gain):
            break
        if gain <= 1e-12 * span + rounding or radius < 1e-14:
            stopped, ended = "converged", rounds
            break
        trial = x + np.append(step, 0.0)
        new_values, new_jacobian = model(points, trial)
        new_span = float(np.ptp(new_values))
        ratio = (span - new_span) / gain
        if ratio > 0.0 and np.isfinite(new_span):
            x, values, jacobian, span = trial, new_values, new_jacobian, new_span
        radius *= 2.0 if ratio > 0.75 else (0.3 if ratio < 0.25 else 1.0)
    middle = 0.5 * float(values.max() + values.min())
    return Band(frame, x + np.append(0.0 * x[1:], middle), values - middle, jacobian, ended, stopped)


def _programme(values: Array, jacobian: Array, radius: float, span: float) -> tuple[Array, float]:
    """Step (p,) in a box that makes the span of the linearised values least, and that span.

    All lengths in units of the present span, so that the solver's tolerance is relative to it.
    """
    count, size = jacobian.shape
    scaled, middle = values / span, 0.5 * (values.max() + values.min()) / span
    one = np.ones((count, 1))
    upper = np.hstack([jacobian, -one, 0 * one])  # values + J s <= top
    lower = np.hstack([-jacobian, 0 * one, one])  # values + J s >= bottom
    cost = np.append(np.zeros(size), [1.0, -1.0])
    box = radius / span
    answer = linprog(
        cost, np.vstack([upper, lower]), np.concatenate([middle - scaled, scaled - middle]),
        bounds=[(-box, box)] * size + [(None, None)] * 2, method="highs-ds",
        options={"primal_feasibility_tolerance": 1e-10, "dual_feasibility_tolerance": 1e-10},
    )  # fmt: skip
    if answer.x is None:
        return np.zeros(size), np.nan
    step = np.asarray(answer.x[:size]) * span
    return step, float(np.ptp(values + jacobian @ step))
