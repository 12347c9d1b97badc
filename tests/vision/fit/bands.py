"""Minimum zones by other roads than the code under test: all candidates where they can be counted (plane, circle), and
for the cylinder optimality conditions solved in many-digit arithmetic and a search from many places."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import mpmath
import numpy as np
from scipy.optimize import minimize, nnls

from tests.vision.fit.minima import DIGITS, STEP, Axis, distances
from tests.vision.fit.reference import Array

BLOCK = 20_000


def flatness(points: Array) -> float:
    """Width of the thinnest slab among those across two lines through two points each: one of them is the thinnest."""
    centred = points - points.mean(axis=0)
    first, second = np.triu_indices(len(points), 1)
    lines = points[second] - points[first]
    lines /= np.maximum(np.linalg.norm(lines, axis=1, keepdims=True), 1e-300)
    one, other = np.triu_indices(len(lines), 1)
    best = np.inf
    for start in range(0, len(one), BLOCK):
        normals = np.cross(lines[one[start : start + BLOCK]], lines[other[start : start + BLOCK]])
        length = np.linalg.norm(normals, axis=1)
        normals = normals[length > 1e-12] / length[length > 1e-12, None]
        best = min(best, float(np.ptp(normals @ centred.T, axis=1).min(initial=np.inf)))
    return best


def roundness(points: Array) -> float:
    """Width of the thinnest ring for points (n, 2) among those whose centre lies on two lines each half way between
    two points: an optimal one has two outer and two inner points, or three of one kind."""
    points = points - points.mean(axis=0)
    first, second = np.triu_indices(len(points), 1)
    lines = points[second] - points[first]
    right = 0.5 * ((points[second] ** 2).sum(axis=1) - (points[first] ** 2).sum(axis=1))
    one, other = np.triu_indices(len(lines), 1)
    best = np.inf
    for start in range(0, len(one), BLOCK):
        a, b = one[start : start + BLOCK], other[start : start + BLOCK]
        det = lines[a, 0] * lines[b, 1] - lines[a, 1] * lines[b, 0]
        cross = np.abs(det) > 1e-12 * np.linalg.norm(lines[a], axis=1) * np.linalg.norm(lines[b], axis=1)
        a, b, det = a[cross], b[cross], det[cross]
        x = (right[a] * lines[b, 1] - right[b] * lines[a, 1]) / det
        y = (lines[a, 0] * right[b] - lines[b, 0] * right[a]) / det
        near = np.hypot(x, y) < 1e6
        radii = np.hypot(points[:, 0] - x[near, None], points[:, 1] - y[near, None])
        best = min(best, float(np.ptp(radii, axis=1).min(initial=np.inf)))
    return best


@dataclass(frozen=True)
class Band:
    """Width of a cylindrical band, and whether it is settled: the conditions hold, no multiplier is negative and no
    point lies outside, so that no small change of the axis makes the band narrower to first order."""

    width: float
    settled: bool


def on_axis(points: Array, point: Array, direction: Array) -> tuple[Axis, Array]:
    """Axis parameters of `minima.distances`, radius half way between the bounds."""
    main = int(np.argmax(np.abs(direction)))
    others = [i for i in range(3) if i != main]
    axis = Axis(main, float(points[:, main].mean()))
    place = point + (axis.height - point[main]) / direction[main] * direction
    x = np.array([*place[others], *(direction[others] / direction[main]), 0.0])
    radii = distances("cylinder", points, axis, x)[0]
    x[4] = 0.5 * (radii.max() + radii.min())
    return axis, x


def searched(points: Array, point: Array, direction: Array) -> tuple[float, Array, Array]:
    """Width and axis (point, direction) to which sequential quadratic programming (SLSQP) comes from an axis."""
    axis, start = on_axis(points, point, direction)
    width = max(float(np.abs(distances("cylinder", points, axis, start)[0]).max()), 1e-12)
    unit = width * np.array([1.0, 1.0, 0.0, 0.0, 1.0])
    unit[2:4] = width / (np.abs(points[:, axis.main] - axis.height).max() + 1e-9)

    def relative(v: Array) -> Array:
        return np.asarray(distances("cylinder", points, axis, start + unit * v[:5])[0]) / width

    bound = {"type": "ineq", "fun": lambda v: np.concatenate([v[5] - relative(v), v[5] + relative(v)])}
    found = minimize(
        lambda v: v[5], np.array([0, 0, 0, 0, 0, 1.1]), constraints=[bound], method="SLSQP",
        options={"maxiter": 200, "ftol": 1e-12},
    )  # fmt: skip
    x = start + unit * found.x[:5]
    place, lean = np.insert(x[:2], axis.main, axis.height), np.insert(x[2:4], axis.main, 1.0)
    return float(np.ptp(relative(found.x))) * width, place, lean / np.linalg.norm(lean)


def certified(points: Array, point: Array, direction: Array) -> Band:
    """The optimality conditions solved near an axis by Newton's method in many digits.

    The points that carry the band come from non-negative least squares on the gradients of those on its bounds.
    """
    axis, x = on_axis(points, point, direction)
    residuals = distances("cylinder", points, axis, x)[0]
    half = float(np.abs(residuals).max())
    bound = np.flatnonzero(np.abs(residuals) > half - max(1e-6 * half, 1e-9))
    with mpmath.workdps(DIGITS):
        exact = np.array([[mpmath.mpf(float(v)) for v in row] for row in points], dtype=object)
        z = [mpmath.mpf(float(v)) for v in x]
        sides = np.sign(residuals[bound]).astype(int)
        slopes = np.array([[float(v) for v in gradient(exact[[k]], axis, z)] for k in bound])
        columns = np.vstack([(sides[:, None] * slopes).T, np.ones(len(bound))])
        scale = np.linalg.norm(slopes, axis=0).max(initial=1e-12)
        weights, _ = nnls(columns / np.append(np.full(5, scale), 1.0)[:, None], np.append(np.zeros(5), 1.0))
        carry = bound[weights > 1e-9]
        signs = [int(s) for s in np.sign(residuals[carry])]
        state = mpmath.matrix([*z, half, *weights[weights > 1e-9]])
        settled = False
        for _ in range(12):
            value, matrix = conditions(exact[carry], axis, signs, state)
            try:
                step = mpmath.lu_solve(matrix, -value)
            except ZeroDivisionError:
                return Band(2.0 * half, False)
            state += step
            if max(abs(v) for v in step) < mpmath.mpf(10) ** -30:
                settled = True
                break
        final = np.array(list(state[:5]), dtype=object)
        worst = max(abs(v) for v in distances("cylinder", exact, axis, final)[0])
        valid = settled and min(state[6:]) >= 0 and worst <= state[5] * (1 + mpmath.mpf(10) ** -20)
        return Band(2.0 * float(state[5]), bool(valid))


def gradient(point: Any, axis: Axis, z: list[Any]) -> list[Any]:
    """Derivatives of one distance by the five parameters."""
    result = []
    for i in range(5):
        ahead, behind = list(z), list(z)
        ahead[i] += STEP
        behind[i] -= STEP
        result.append((one(point, axis, ahead) - one(point, axis, behind)) / (2 * STEP))
    return result


def one(point: Any, axis: Axis, z: list[Any]) -> Any:
    return distances("cylinder", point, axis, np.array(z, dtype=object))[0][0]


def conditions(points: Any, axis: Axis, signs: list[int], state: mpmath.matrix) -> tuple[mpmath.matrix, mpmath.matrix]:
    """Karush-Kuhn-Tucker equations of the points that carry the band, and their derivatives."""
    z, half, weights = list(state[:5]), state[5], list(state[6:])
    count = len(signs)
    value, matrix = mpmath.matrix(6 + count, 1), mpmath.matrix(6 + count, 6 + count)
    for k, sign in enumerate(signs):
        point = points[[k]]
        slope = gradient(point, axis, z)
        value[6 + k] = sign * one(point, axis, z) - half
        matrix[6 + k, 5] = -1
        matrix[5, 6 + k] = 1
        for i in range(5):
            value[i] += weights[k] * sign * slope[i]
            matrix[6 + k, i] = matrix[i, 6 + k] = sign * slope[i]
            shifted = list(z)
            shifted[i] += STEP
            ahead = gradient(point, axis, shifted)
            for j in range(5):
                matrix[j, i] += weights[k] * sign * (ahead[j] - slope[j]) / STEP
    value[5] = sum(weights) - 1
    return value, matrix
