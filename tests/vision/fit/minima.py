"""Least-squares minima in many-digit arithmetic (mpmath), by another road than the code under test.

The element is put in the coordinates of the points themselves: a point and an axis whose largest component is one.
Gradient and Hessian are differences of the sum of squares alone, at steps that only such arithmetic allows, so no
derivative is taken over from anywhere. Newton's method then doubles the digits with each step.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import mpmath
import numpy as np
from scipy.optimize import least_squares

from cellctl.vision.fit import Element
from tests.vision.fit.reference import Array

DIGITS = 100
STEP = mpmath.mpf(10) ** -30
"""Differences of 100 digits at this step leave the gradient more than 50 and the Hessian 30."""

SHAPES = {"line": 4, "plane": 3, "circle": 6, "sphere": 4, "cylinder": 5, "cone": 6}

Guess = tuple[Array, Array | None, float, float]
"""Point, direction, radius there, half angle."""

Numbers = Any
"""An array of float64 or an object array of mpmath numbers; the formulas are the same."""


@dataclass(frozen=True)
class Axis:
    """Which component of the axis is one, and the height at which its point stands: what is not varied."""

    main: int
    height: float


@dataclass(frozen=True)
class Found:
    """A stationary minimum: sum of squares and the element in float64 (`point` on it, the foot of the centroid)."""

    cost: float
    point: Array
    direction: Array | None
    radius: float
    apex_rad: float
    settled: bool


def root(values: Numbers) -> Numbers:
    """Square root of each, or of one."""
    if isinstance(values, np.ndarray) and values.dtype == object:
        return np.array([mpmath.sqrt(value) for value in values], dtype=object)
    return mpmath.sqrt(values) if isinstance(values, mpmath.mpf) else np.sqrt(values)


def terms(points: Numbers, axis: Axis, place: Numbers, lean: Numbers) -> tuple[Numbers, Numbers]:
    """Height along the axis and squared distance from it, of each point."""
    others = [i for i in range(3) if i != axis.main]
    length = root(lean[0] ** 2 + lean[1] ** 2 + 1)
    a = [lean[0] / length, lean[1] / length, 1 / length]
    d = [points[:, others[0]] - place[0], points[:, others[1]] - place[1], points[:, axis.main] - axis.height]
    # array times number, not the other way: mpmath would first write the array into an error message
    height = d[0] * a[0] + d[1] * a[1] + d[2] * a[2]
    cross = (d[2] * a[1] - d[1] * a[2], d[0] * a[2] - d[2] * a[0], d[1] * a[0] - d[0] * a[1])
    return height, cross[0] ** 2 + cross[1] ** 2 + cross[2] ** 2


def distances(kind: str, points: Numbers, axis: Axis, x: Numbers) -> list[Numbers]:
    """Orthogonal distances; for line and circle two of them to each point, or their squares' root."""
    if kind == "sphere":
        return [root(((points - x[:3]) ** 2).sum(axis=1)) - x[3]]
    if kind == "plane":
        height, _ = terms(points, axis, [0 * x[0], 0 * x[0]], x[1:3])
        return [height - x[0]]
    height, square = terms(points, axis, x[:2], x[2:4])
    if kind == "line":
        return [root(square)]
    if kind == "circle":
        return [height - x[5], root(square) - x[4]]
    if kind == "cylinder":
        return [root(square) - x[4]]
    return [(root(square) - x[4] - height * x[5]) / root(1 + x[5] ** 2)]


def parameters(kind: str, points: Array, guess: Guess) -> tuple[Axis, Array]:
    """Point, direction, radius there and half angle as the parameters of `distances`."""
    point, direction, radius, half = guess
    if kind == "sphere":
        return Axis(2, 0.0), np.append(point, radius)
    assert direction is not None
    main = int(np.argmax(np.abs(direction)))
    others = [i for i in range(3) if i != main]
    lean = direction[others] / direction[main]
    axis = Axis(main, float(points[:, main].mean()))
    sign = float(np.sign(direction[main]))
    if kind == "plane":
        away = point.copy()
        away[main] -= axis.height
        return axis, np.array([sign * float(away @ direction), *lean])
    rise = (axis.height - point[main]) / direction[main] if kind != "circle" else 0.0
    if kind == "circle":
        axis = Axis(main, float(point[main]))
    place = (point + rise * direction)[others]
    taper = sign * np.tan(half)
    tail = {"line": [], "circle": [radius, 0.0], "cylinder": [radius]}.get(
        kind, [radius + rise * np.tan(half), taper]
    )  # fmt: skip
    return axis, np.array([*place, *lean, *tail])


def element(kind: str, points: Array, axis: Axis, x: Numbers, cost: Any, settled: bool) -> Found:
    """The parameters as point, direction, radius and full apex angle."""
    if kind == "sphere":
        return Found(float(cost), x[:3].astype(float), None, float(x[3]), 0.0, settled)
    lean = x[1:3] if kind == "plane" else x[2:4]
    others = [i for i in range(3) if i != axis.main]
    direction, place = np.empty(3, dtype=object), np.empty(3, dtype=object)
    length = root(lean[0] ** 2 + lean[1] ** 2 + 1)
    direction[others], direction[axis.main] = lean / length, 1 / length
    place[axis.main] = mpmath.mpf(axis.height)
    place[others] = [mpmath.mpf(0)] * 2 if kind == "plane" else x[:2]
    exact = np.array([[mpmath.mpf(float(v)) for v in row] for row in points], dtype=object)
    centroid = exact.sum(axis=0) / len(points)
    along = direction @ (centroid - place)
    if kind == "plane":
        foot = centroid - direction * (along - x[0])
    else:
        foot = place + direction * (x[5] if kind == "circle" else along)
    radius = x[4] if len(x) > 4 else mpmath.mpf(0)
    half = mpmath.mpf(0)
    if kind == "cone":
        radius, half = radius + x[5] * along, mpmath.atan(x[5])
        direction = direction if half >= 0 else -direction
    apex = 2.0 * abs(float(half))
    return Found(float(cost), foot.astype(float), direction.astype(float), float(radius), apex, settled)


def near(kind: str, points: Array, axis: Axis, start: Array) -> Array:
    """Minimum in float64 by scipy's least squares, as a place from which Newton's method arrives."""

    def residuals(x: Array) -> Array:
        return np.concatenate(distances(kind, points, axis, x))

    return np.asarray(
        least_squares(
            residuals, start, x_scale="jac", jac="3-point", xtol=1e-15, ftol=1e-15, gtol=1e-15, max_nfev=200
        ).x
    )


def guess_of(found: Element) -> Guess:
    """A result as a start."""
    half = 0.5 * float(np.radians(found.apex_angle_deg or 0.0))
    return found.point_mm, found.direction, found.radius_mm or 0.0, half


def sum_of_squares(kind: str, points: Array, guess: Guess) -> float:
    """Of an element as it is."""
    axis, x = parameters(kind, points, guess)
    return float(sum((part @ part for part in distances(kind, points, axis, x)), 0.0))


def near_cost(kind: str, points: Array, guess: Guess) -> float:
    """Sum of squares downhill of `guess`, in float64."""
    axis, x = parameters(kind, points, guess)
    return float(sum((part @ part for part in distances(kind, points, axis, near(kind, points, axis, x))), 0.0))


def minimum(kind: str, points: Array, guess: Guess, *, descend: bool = True) -> Found:
    """The minimum that lies downhill of `guess` (point, direction, radius there, half angle)."""
    axis, start = parameters(kind, points, guess)
    if descend:
        start = near(kind, points, axis, start)
    with mpmath.workdps(DIGITS):
        exact = np.array([[mpmath.mpf(float(v)) for v in row] for row in points], dtype=object)

        def cost(x: Numbers) -> Any:
            return sum((part @ part for part in distances(kind, exact, axis, x)), mpmath.mpf(0))

        x = np.array([mpmath.mpf(float(v)) for v in start], dtype=object)
        x, least, settled = newton(cost, x)
        return element(kind, points, axis, x, least, settled)


def newton(cost: Callable[[Numbers], Any], x: Numbers, rounds: int = 30) -> tuple[Numbers, Any, bool]:
    """Newton's method on differences of `cost`: (parameters, cost, whether the last step was below 1e-25).

    Negative curvature is turned round; damping grows where the cost would rise and vanishes where it falls.
    """
    here, damping = cost(x), mpmath.mpf(0)
    for _ in range(rounds):
        gradient, hessian = derivatives(cost, x, here)
        values, vectors = mpmath.eigsy(hessian)
        steepest = max(abs(v) for v in values)
        floor = steepest * mpmath.mpf(10) ** -24
        inside = vectors.T * gradient
        while True:
            step = [-g / max(abs(v) + damping, floor) for g, v in zip(inside, values, strict=True)]
            move = np.array(list(vectors * mpmath.matrix(step)), dtype=object)
            there, size = cost(x + move), max(abs(v) for v in move)
            if there <= here or size < mpmath.mpf(10) ** -40:
                break
            damping = max(10 * damping, steepest * mpmath.mpf(10) ** -16)
        x, here = x + move, there
        if min(values) > floor and damping == 0 and size < mpmath.mpf(10) ** -25:
            return x, here, True
        damping = damping / 100 if damping > steepest * mpmath.mpf(10) ** -15 else mpmath.mpf(0)
    return x, here, False


def derivatives(cost: Callable[[Numbers], Any], x: Numbers, here: Any) -> tuple[mpmath.matrix, mpmath.matrix]:
    """Gradient and Hessian of `cost` at `x`, where it is `here`."""
    size = len(x)
    unit = [np.array([STEP if i == j else mpmath.mpf(0) for i in range(size)], dtype=object) for j in range(size)]
    ahead, behind = [cost(x + u) for u in unit], [cost(x - u) for u in unit]
    gradient = mpmath.matrix([(a - b) / (2 * STEP) for a, b in zip(ahead, behind, strict=True)])
    hessian = mpmath.matrix(size, size)
    for i in range(size):
        hessian[i, i] = (ahead[i] - 2 * here + behind[i]) / STEP**2
        for j in range(i):
            both = (cost(x + unit[i] + unit[j]) - ahead[i] - ahead[j] + here) / STEP**2
            hessian[i, j] = hessian[j, i] = both
    return gradient, hessian
