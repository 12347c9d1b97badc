"""Line, plane, circle in space, sphere, cylinder and cone by least squares of the orthogonal distance.

The parametrisations are those common in coordinate metrology (Forbes, NPL report DITC 140/89; Shakarji, J. Res. NIST
103 (1998) 633): the axis is a point in a plane across it and two slopes, all in a frame near the answer. Start values
come from algebraic fits along many directions, so no caller has to give any. Points (N, 3) in mm; every function
raises FitError where they do not determine the element.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from cellctl.vision.fit.covariance import type_a
from cellctl.vision.fit.result import Array, Element, FitError, checked, frame_of, principal, signed
from cellctl.vision.fit.solve import Minimum, Model, least_squares
from cellctl.vision.fit.starts import circle_in_plane, cone_starts, cylinder_starts

Points = NDArray[np.floating]


def line(points_mm: Points) -> Element:
    """Line through at least 2 points. `zone_mm` is twice the largest distance. Parameters: x, y across, slopes."""
    points = checked(points_mm, 2)
    centre, spread, rows = principal(points)
    if spread[2] <= 0.0 or spread[1] > (1.0 - 1e-9) * spread[2]:
        raise FitError("the points have no direction")
    frame = frame_of(signed(rows[2]))
    local = (points - centre) @ frame.T
    one, nothing = np.ones(len(points)), np.zeros(len(points))
    design = np.vstack(
        [
            np.column_stack([-one, nothing, -local[:, 2], nothing]),
            np.column_stack([nothing, -one, nothing, -local[:, 2]]),
        ]
    )
    distances = np.hypot(local[:, 0], local[:, 1])
    covariance = type_a(design, np.concatenate([local[:, 0], local[:, 1]]))
    return Element("line", centre, distances, 2.0 * float(distances.max()), frame[2], covariance=covariance,
                   parameters=("x_mm", "y_mm", "slope_x", "slope_y"), stopped="closed form")  # fmt: skip


def plane(points_mm: Points) -> Element:
    """Plane through at least 3 points. Parameters: offset, slopes."""
    points = checked(points_mm, 3)
    centre, spread, rows = principal(points)
    if spread[1] <= 1e-12 * spread[2]:
        raise FitError("the points lie on a line")
    frame = frame_of(signed(rows[0]))
    local = (points - centre) @ frame.T
    design = np.column_stack([-np.ones(len(points)), -local[:, :2]])
    return Element("plane", centre, local[:, 2], float(np.ptp(local[:, 2])), frame[2],
                   covariance=type_a(design, local[:, 2]), parameters=("offset_mm", "slope_x", "slope_y"),
                   stopped="closed form")  # fmt: skip


def sphere(points_mm: Points) -> Element:
    """Sphere through at least 4 points. Parameters: x, y, z, radius."""
    points = checked(points_mm, 4)
    local, centre, scale = _scaled(points)
    design = np.column_stack([2.0 * local, np.ones(len(local))])
    solution, _, rank, _ = np.linalg.lstsq(design, (local**2).sum(axis=1), rcond=1e-12)
    if rank < 4:
        raise FitError("the points lie in a plane")
    radius = np.sqrt(max(float(solution[3] + solution[:3] @ solution[:3]), 1e-12))

    def model(x: Array) -> tuple[Array, Array]:
        offset = local - x[:3]
        rho = np.maximum(np.linalg.norm(offset, axis=1), 1e-300)
        return rho - x[3], np.column_stack([-offset / rho[:, None], -np.ones(len(rho))])

    found = least_squares(model, np.append(solution[:3], radius))
    residuals = found.residuals * scale
    return Element("sphere", centre + scale * found.parameters[:3], residuals, float(np.ptp(residuals)),
                   radius_mm=scale * float(found.parameters[3]), covariance=_covariance(found, [scale] * 4),
                   parameters=("x_mm", "y_mm", "z_mm", "radius_mm"), iterations=found.iterations,
                   stopped=found.stopped)  # fmt: skip


def circle(points_mm: Points) -> Element:
    """Circle in space: sum of squared distances in 3-D, at least 3 points. Parameters: centre, radius, slopes.

    `residuals_mm` are the signed radial ones; `zone_mm` is their span.
    """
    points = checked(points_mm, 3)
    local, centre, scale = _scaled(points)
    _, spread, rows = principal(local)
    if spread[1] <= 1e-9 * spread[2]:
        raise FitError("the points lie on a line")
    frame = frame_of(signed(rows[0]))
    flat = local @ frame.T
    start = circle_in_plane(flat[:, :2])
    found = least_squares(_circle_model(flat), np.array([start[0], start[1], 0.0, start[2], 0.0, 0.0]))
    x = found.parameters
    normal = signed(frame.T @ _direction(x[4], x[5]))
    radial = found.residuals[len(points) :] * scale
    return Element("circle", centre + scale * (frame.T @ x[:3]), radial, float(np.ptp(radial)), normal,
                   scale * float(x[3]), covariance=_covariance(found, [scale] * 4 + [1.0, 1.0]),
                   parameters=("x_mm", "y_mm", "z_mm", "radius_mm", "slope_x", "slope_y"),
                   iterations=found.iterations, stopped=found.stopped)  # fmt: skip


def _circle_model(points: Array) -> Model:
    """Residuals out of the plane, then radial; parameters cx, cy, cz, radius, slopes."""

    def model(x: Array) -> tuple[Array, Array]:
        normal, height, across, rho, length = _axis_terms(points, x[:3], x[4], x[5])
        one, nothing = np.ones(len(rho)), np.zeros(len(rho))
        out = np.column_stack([*(-one * item for item in normal), nothing, across[:, :2] / length])
        pull = -(height / rho / length)[:, None] * across[:, :2]
        radial = np.column_stack([-across / rho[:, None], -one, pull])
        return np.concatenate([height, rho - x[3]]), np.vstack([out, radial])

    return model


def cylinder(points_mm: Points) -> Element:
    """Cylinder through at least 5 points; `point_mm` is the centroid's foot on the axis. Parameters: x, y, slopes,
    radius, in a frame whose third axis is the axis."""
    points = checked(points_mm, 5)
    local, centre, scale = _scaled(points)
    best = _best(local, cylinder_starts(local), cylinder_model)
    if best is None:
        raise FitError("the points do not determine a cylinder")
    frame, found = best
    x = found.parameters
    axis = frame.T @ _direction(x[2], x[3])
    on_axis = frame.T @ np.array([x[0], x[1], 0.0])
    foot = on_axis - (on_axis @ axis) * axis  # the centroid is the origin
    residuals = found.residuals * scale
    return Element("cylinder", centre + scale * foot, residuals, float(np.ptp(residuals)), signed(axis),
                   scale * float(x[4]), covariance=_covariance(found, [scale, scale, 1.0, 1.0, scale]),
                   parameters=("x_mm", "y_mm", "slope_x", "slope_y", "radius_mm"), iterations=found.iterations,
                   stopped=found.stopped)  # fmt: skip


def cylinder_model(points: Array) -> Model:
    """Residuals and Jacobian for the parameters x, y, slopes, radius of a cylinder along about the third axis."""

    def model(x: Array) -> tuple[Array, Array]:
        _, height, across, rho, length = _axis_terms(points, np.array([x[0], x[1], 0.0]), x[2], x[3])
        lateral = -across[:, :2] / rho[:, None]
        return rho - x[4], np.column_stack([lateral, lateral * (height / length)[:, None], -np.ones(len(rho))])

    return model


def cone(points_mm: Points) -> Element:
    """Cone through at least 6 points; `point_mm` is the centroid's foot on the axis, `radius_mm` the one there,
    `direction` the way in which it widens. Parameters: x, y, slopes, distance (radius times cosine), half angle."""
    points = checked(points_mm, 6)
    local, centre, scale = _scaled(points)
    best = _best(local, cone_starts(local), _cone_model)
    if best is None:
        raise FitError("the points do not determine a cone")
    frame, found = best
    x = found.parameters
    axis = frame.T @ _direction(x[2], x[3])
    on_axis = frame.T @ np.array([x[0], x[1], 0.0])
    foot = on_axis - (on_axis @ axis) * axis
    # the parameters' height is measured from `on_axis`, the point's from the foot
    radius = float((x[4] + (foot - on_axis) @ axis * np.sin(x[5])) / np.cos(x[5]))
    if x[5] < 0.0:
        axis = -axis
    residuals = found.residuals * scale
    return Element("cone", centre + scale * foot, residuals, float(np.ptp(residuals)), axis, scale * radius,
                   2.0 * float(np.degrees(abs(x[5]))), _covariance(found, [scale, scale, 1.0, 1.0, scale, 1.0]),
                   ("x_mm", "y_mm", "slope_x", "slope_y", "distance_mm", "half_angle_rad"), found.iterations,
                   found.stopped)  # fmt: skip


def _cone_model(points: Array) -> Model:
    def model(x: Array) -> tuple[Array, Array]:
        axis, height, across, rho, length = _axis_terms(points, np.array([x[0], x[1], 0.0]), x[2], x[3])
        c, s = np.cos(x[5]), np.sin(x[5])
        lateral = -across[:, :2] / rho[:, None]
        place = c * lateral + s * axis[:2]
        slopes = c * lateral * (height / length)[:, None] - s * across[:, :2] / length
        one = np.ones(len(rho))
        return c * rho - s * height - x[4], np.column_stack([place, slopes, -one, -s * rho - c * height])

    return model


def _axis_terms(points: Array, foot: Array, slope_x: float, slope_y: float) -> tuple[Array, Array, Array, Array, float]:
    """Axis, height along it, vector and distance across it for each point, and the length of (slope_x, slope_y, 1)."""
    length = float(np.sqrt(1.0 + slope_x**2 + slope_y**2))
    axis = np.array([slope_x, slope_y, 1.0]) / length
    offset = points - foot
    height = offset @ axis
    across = offset - height[:, None] * axis
    return axis, height, across, np.maximum(np.linalg.norm(across, axis=1), 1e-300), length


def _direction(slope_x: float, slope_y: float) -> Array:
    vector = np.array([slope_x, slope_y, 1.0])
    return np.asarray(vector / np.linalg.norm(vector))


def _scaled(points: Array) -> tuple[Array, Array, float]:
    """Points about their centroid in units of their spread, the centroid and that unit."""
    centre = points.mean(axis=0)
    scale = float(np.sqrt(((points - centre) ** 2).sum(axis=1).mean()))
    return (points - centre) / scale, centre, scale


def _best(
    local: Array, starts: list[tuple[Array, Array]], build: Callable[[Array], Model]
) -> tuple[Array, Minimum] | None:
    """Least minimum over the starts (direction, parameters across it): (frame, minimum) in a frame of its own axis."""
    best: tuple[Array, Minimum] | None = None
    for direction, start in starts:
        frame = frame_of(direction)
        found = least_squares(build(local @ frame.T), start, limit=60)
        for _ in range(3):  # again from the axis found: slopes near zero, the parameters' best place
            turned = frame_of(frame.T @ _direction(found.parameters[2], found.parameters[3]))
            found = least_squares(build(local @ turned.T), _moved(found.parameters, frame, turned))
            frame = turned
            if np.abs(found.parameters[2:4]).max() < 1e-6:
                break
        if np.isfinite(found.cost) and (best is None or found.cost < best[1].cost * (1.0 - 1e-9)):
            best = frame, found
    return best


def _moved(parameters: Array, frame: Array, turned: Array) -> Array:
    """Parameters of an axis in a frame whose third axis it is: foot where it pierces the plane through the origin."""
    point = turned @ (frame.T @ np.array([parameters[0], parameters[1], 0.0]))
    result = parameters.copy()
    result[:2], result[2:4] = point[:2], 0.0
    if len(parameters) == 6:  # a cone's distance is that at height zero
        result[4] = parameters[4] - point[2] * np.sin(parameters[5])
    return result


def _covariance(found: Minimum, units: list[float]) -> Array:
    """Type A covariance with every parameter brought from the scaled fit to its own unit."""
    factor = np.array(units)
    return np.asarray(type_a(found.jacobian, found.residuals) * np.outer(factor, factor))
