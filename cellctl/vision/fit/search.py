"""The least of the minima that many starts lead to, in millimetres and in a frame of the element's own axis."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np

from cellctl.vision.fit.result import Array, FitError, frame_of
from cellctl.vision.fit.solve import Minimum, Model, descend, determined, settle

TURNS = 3
ROUNDS = 12
"""Coarse rounds from every start, that many times, the frame turned upright after each."""
SETTLED = 4
"""Candidates that are taken to the bottom: the least ones after the coarse rounds that are not alike."""
LONG, SHORT, STRIDE = 300, 60, 20
"""Steps granted to the least candidate and to the others, which have little hope, and before the frame is turned."""
SAMPLE = 200
"""Points that are enough to choose between starts."""


@dataclass(frozen=True, slots=True)
class Shape:
    """What is searched for: starts give frames (b, 3, 3) and parameters (b, p), `angles` are the parameters that are
    no lengths; where there are any, the first two are the slopes of an axis."""

    name: str
    model: Model
    starts: Callable[[Array], tuple[Array, Array]]
    angles: tuple[int, ...] = ()


@dataclass(frozen=True, slots=True)
class Fitted:
    """A minimum: parameters, residuals and Jacobian in mm, in a frame (rows) about the points' centroid."""

    frame: Array
    centroid_mm: Array
    parameters_mm: Array
    residuals_mm: Array
    jacobian: Array
    iterations: int
    stopped: str

    def place(self, x_mm: float, y_mm: float, z_mm: float = 0.0) -> Array:
        """A place in the frame as a place among the points."""
        return np.asarray(self.centroid_mm + np.array([x_mm, y_mm, z_mm]) @ self.frame)


def least(shape: Shape, points: Array) -> Fitted:
    """The least minimum for points (n, 3).

    Raises FitError where the least candidate does not settle or could be moved at no cost.
    """
    centroid = points.mean(axis=0)
    scale = float(np.sqrt(((points - centroid) ** 2).sum(axis=1).mean()))
    local = (points - centroid) / scale
    with np.errstate(all="ignore"):  # candidates far off may overflow and are dropped
        best = _best(shape, local)
    if best is None or not determined(best[1].jacobian):
        raise FitError(f"the points do not determine a {shape.name}")
    frame, found = best
    unit = np.full(len(found.parameters), scale)
    unit[list(shape.angles)] = 1.0
    return Fitted(frame, centroid, found.parameters * unit, found.residuals * scale, found.jacobian * scale / unit,
                  found.iterations, found.stopped)  # fmt: skip


def _best(shape: Shape, local: Array) -> tuple[Array, Minimum] | None:
    """Frame and minimum with the least sum of squares; None where that one does not settle."""
    best: tuple[Array, Minimum] | None = None
    for frame, x in candidates(shape, local):
        found = _settled(shape, local, frame, x, LONG if best is None else SHORT)
        if best is None or _lower(found[1], best[1]):
            best = found
    return best if best is not None and best[1].stopped == "converged" else None


def candidates(shape: Shape, local: Array) -> list[tuple[Array, Array]]:
    """Frames and parameters near the lowest minima, the lowest first."""
    points = sample(local)
    frames, x = shape.starts(points)
    for _ in range(TURNS):
        x, costs = descend(shape.model, points @ np.swapaxes(frames, 1, 2), x, ROUNDS)
        frames, x = upright(shape, frames, x)
    return distinct(shape, points, frames, x, costs)


def sample(local: Array) -> Array:
    """Some of many points, evenly; all of few."""
    return local[:: -(-len(local) // SAMPLE)]


def distinct(shape: Shape, points: Array, frames: Array, x: Array, costs: Array) -> list[tuple[Array, Array]]:
    """The first few by cost that do not lie so near each other that they would lead to one minimum."""
    seen: list[Array] = []
    kept: list[tuple[Array, Array]] = []
    for k in np.argsort(costs, kind="stable"):
        residuals = np.abs(shape.model(points @ frames[k].T, x[k])[0])  # a frame may stand on its head
        alike = any(np.linalg.norm(residuals - one) <= 0.01 * np.linalg.norm(one) + 1e-9 for one in seen)
        if len(seen) < SETTLED and not alike and np.isfinite(residuals).all():
            seen.append(residuals)
            kept.append((frames[k], x[k]))
    return kept


def _lower(one: Minimum, other: Minimum) -> bool:
    """Whether `one` is the lower minimum, or the settled one of two alike."""
    if abs(one.cost - other.cost) <= 10.0 * other.rounding:
        return one.stopped == "converged" and other.stopped != "converged"
    return one.cost < other.cost


def _settled(shape: Shape, local: Array, frame: Array, start: Array, limit: int) -> tuple[Array, Minimum]:
    """The minimum near `start` within `limit` steps, in a frame turned until its third axis is the one found."""
    found = settle(shape.model, local @ frame.T, start, min(limit, STRIDE))
    while shape.angles:
        limit -= found.iterations + 1
        slopes = np.abs(found.parameters[2:4]).max()
        (frame,), (x,) = upright(shape, frame[None], found.parameters[None])
        if slopes < 1e-9:  # nothing but rounding is left to move
            residuals, jacobian = shape.model(local @ frame.T, x)
            return frame, replace(found, parameters=x, residuals=residuals, jacobian=jacobian)
        if limit <= 0:
            return frame, replace(found, stopped="limit")
        found = settle(shape.model, local @ frame.T, x, min(limit, STRIDE))
    return frame, found


def upright(shape: Shape, frames: Array, x: Array) -> tuple[Array, Array]:
    """The same elements in frames whose third axis is theirs: frames (b, 3, 3), parameters (b, p) with slopes zero."""
    if not shape.angles:
        return frames, x
    one, nothing = np.ones(len(x)), np.zeros(len(x))
    axes = (np.column_stack([x[:, 2:4], one])[:, None] @ frames)[:, 0]
    turned = frame_of(axes / np.linalg.norm(axes, axis=1, keepdims=True))
    height = x[:, 4] if shape.name == "circle" else nothing
    points = (turned @ np.swapaxes(frames, 1, 2) @ np.column_stack([x[:, :2], height])[..., None])[..., 0]
    x = np.column_stack([points[:, :2], nothing, nothing, x[:, 4:]])
    if shape.name == "circle":
        x[:, 4] = points[:, 2]
    elif shape.name == "cone":  # its distance is that at height zero; half a turn on is the same cone inside out
        x[:, 4] -= points[:, 2] * np.sin(x[:, 5])
        half_turns = np.round(x[:, 5] / np.pi)
        x[:, 4] *= np.cos(np.pi * half_turns)
        x[:, 5] -= np.pi * half_turns
    return turned, x
