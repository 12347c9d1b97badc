"""Minimum zones: flatness, roundness, cylindricity as the narrowest band that holds all points.

Minimax by successive linear programmes with a trust region, from the least-squares element: at the solution the
programme's optimum is zero, so it says itself that it has arrived.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import linprog

from cellctl.vision.fit import elements
from cellctl.vision.fit.result import Array, Element, FitError, checked, frame_of, signed
from cellctl.vision.fit.solve import Model

Points = NDArray[np.floating]


def plane_zone(points_mm: Points) -> Element:
    """Flatness: two parallel planes as close as can be (at least 3 points). `point_mm` lies midway."""
    points = checked(points_mm, 3)
    fit = elements.plane(points)
    assert fit.direction is not None
    frame, scale = frame_of(fit.direction), _size(points)
    local = (points - fit.point_mm) @ frame.T / scale

    def model(x: Array) -> tuple[Array, Array]:
        length = np.sqrt(1.0 + x[0] ** 2 + x[1] ** 2)
        height = (local[:, 2] - x[0] * local[:, 0] - x[1] * local[:, 1]) / length
        return height, -local[:, :2] / length - height[:, None] * x[:2] / length**2

    x, residuals, rounds, stopped = _narrowest(model, np.zeros(2))
    normal = frame.T @ (np.array([-x[0], -x[1], 1.0]) / np.sqrt(1.0 + x[0] ** 2 + x[1] ** 2))
    middle = 0.5 * (residuals.max() + residuals.min())
    point = fit.point_mm + scale * middle * normal
    sign = 1.0 if signed(normal) @ normal > 0.0 else -1.0
    return Element("plane_zone", point, sign * scale * (residuals - middle), scale * float(np.ptp(residuals)),
                   sign * normal, iterations=rounds, stopped=stopped)  # fmt: skip


def circle_zone(points_mm: Points) -> Element:
    """Roundness: two concentric circles as close as can be, in the least-squares plane of the points (at least 3)."""
    points = checked(points_mm, 3)
    fit = elements.circle(points)
    flatness = elements.plane(points)
    assert fit.radius_mm is not None and flatness.direction is not None
    frame, scale = frame_of(flatness.direction), _size(points)
    local = ((points - flatness.point_mm) @ frame.T / scale)[:, :2]
    start = ((fit.point_mm - flatness.point_mm) @ frame.T / scale)[:2]

    def model(x: Array) -> tuple[Array, Array]:
        offset = local - x
        rho = np.maximum(np.hypot(offset[:, 0], offset[:, 1]), 1e-300)
        return rho, -offset / rho[:, None]

    x, rho, rounds, stopped = _narrowest(model, start)
    middle = 0.5 * float(rho.max() + rho.min())
    point = flatness.point_mm + scale * (frame.T @ np.append(x, 0.0))
    return Element("circle_zone", point, scale * (rho - middle), scale * float(np.ptp(rho)), frame[2],
                   scale * middle, iterations=rounds, stopped=stopped)  # fmt: skip


def cylinder_zone(points_mm: Points) -> Element:
    """Cylindricity: two coaxial cylinders as close as can be (at least 5 points)."""
    points = checked(points_mm, 5)
    fit = elements.cylinder(points)
    assert fit.direction is not None
    frame, scale = frame_of(fit.direction), _size(points)
    local = (points - fit.point_mm) @ frame.T / scale
    inner = elements.cylinder_model(local)

    def model(x: Array) -> tuple[Array, Array]:
        residuals, jacobian = inner(np.append(x, 0.0))
        return residuals, jacobian[:, :4]

    x, rho, rounds, stopped = _narrowest(model, np.zeros(4))
    middle = 0.5 * float(rho.max() + rho.min())
    axis = np.array([x[2], x[3], 1.0]) / np.sqrt(1.0 + x[2] ** 2 + x[3] ** 2)
    foot = np.array([x[0], x[1], 0.0])
    centroid = local.mean(axis=0)
    foot = foot + ((centroid - foot) @ axis) * axis
    return Element("cylinder_zone", fit.point_mm + scale * (frame.T @ foot), scale * (rho - middle),
                   scale * float(np.ptp(rho)), signed(frame.T @ axis), scale * middle, iterations=rounds,
                   stopped=stopped)  # fmt: skip


def _size(points: Array) -> float:
    """Unit of length in which the points are of order one."""
    return float(np.sqrt(((points - points.mean(axis=0)) ** 2).sum(axis=1).mean()))


def _narrowest(model: Model, start: Array, *, limit: int = 200) -> tuple[Array, Array, int, str]:
    """Parameters at which the span of `model`'s values is least: (parameters, values, rounds, why it stopped).

    Each round minimises the span of the linearised values within a box; the box grows when the model was right and
    shrinks when it was not.
    """
    x = start.copy()
    values, jacobian = model(x)
    span = float(np.ptp(values))
    radius = 2.0 * span + 1e-9
    for round_ in range(limit):
        if span < 1e-15 or radius < 1e-14:
            return x, values, round_, "converged"
        step, predicted = _programme(values, jacobian, radius, span)
        gain = span - predicted
        if gain <= 1e-12 * span:
            return x, values, round_, "converged"
        new_values, new_jacobian = model(x + step)
        new_span = float(np.ptp(new_values))
        ratio = (span - new_span) / gain
        if ratio > 0.0 and np.isfinite(new_span):
            x, values, jacobian, span = x + step, new_values, new_jacobian, new_span
        radius *= 2.0 if ratio > 0.75 else (0.3 if ratio < 0.25 else 1.0)
    return x, values, limit, "limit"


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
        raise FitError(f"the minimum zone was not found: {answer.message}")
    step = np.asarray(answer.x[:size]) * span
    return step, float(np.ptp(values + jacobian @ step))
