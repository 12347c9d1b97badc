"""Line, plane, circle in space, sphere, cylinder and cone by least squares of the orthogonal distance.

Start values come from algebraic fits along many directions, so no caller has to give any, and the least of all minima
that they lead to is taken. Points (N, 3) in mm; every function raises FitError where they do not determine the element.
`covariance` is of `parameters`: the components of point, direction and the sizes, with the point held where it is along
the axis or in the plane, where it is the caller's choice and not measured.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from cellctl.vision.fit import models, starts
from cellctl.vision.fit.covariance import type_a
from cellctl.vision.fit.result import Array, Element, FitError, checked, frame_of, principal, signed
from cellctl.vision.fit.search import Shape, least

Points = NDArray[np.floating]
POINT = ("point_x_mm", "point_y_mm", "point_z_mm")
DIRECTION = ("direction_x", "direction_y", "direction_z")
SPHERE = Shape("sphere", models.sphere, starts.spheres)
CIRCLE = Shape("circle", models.circle, starts.circles, (2, 3))
CYLINDER = Shape("cylinder", models.cylinder, starts.cylinders, (2, 3))
CONE = Shape("cone", models.cone, starts.cones, (2, 3, 5))


def line(points_mm: Points) -> Element:
    """Line through at least 2 points. `zone_mm` is twice the largest distance."""
    points = checked(points_mm, 2, dimensions=1)
    centre, spread, rows = principal(points)
    if spread[1] > (1.0 - 1e-9) * spread[2]:
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
    covariance = type_a(design, local[:, :2].T.ravel(), _axis_derivative(frame))
    return Element("line", centre, distances, 2.0 * float(distances.max()), frame[2], covariance=covariance,
                   parameters=POINT + DIRECTION, stopped="closed form")  # fmt: skip


def plane(points_mm: Points) -> Element:
    """Plane through at least 3 points."""
    points = checked(points_mm, 3)
    centre, spread, rows = principal(points)
    if spread[0] > (1.0 - 1e-9) * spread[1]:
        raise FitError("the points have no plane: they are as wide across it as within")
    frame = frame_of(signed(rows[0]))
    local = (points - centre) @ frame.T
    design = np.column_stack([-np.ones(len(points)), -local[:, :2]])
    derivative = np.zeros((6, 3))
    derivative[:3, 0], derivative[3:, 1:] = frame[2], -frame[:2].T
    return Element("plane", centre, local[:, 2], float(np.ptp(local[:, 2])), frame[2],
                   covariance=type_a(design, local[:, 2], derivative), parameters=POINT + DIRECTION,
                   stopped="closed form")  # fmt: skip


def sphere(points_mm: Points) -> Element:
    """Sphere through at least 4 points; `point_mm` is its centre."""
    points = checked(points_mm, 4)
    found = least(SPHERE, points)
    x = found.parameters_mm
    covariance = type_a(found.jacobian, found.residuals_mm, np.eye(4))
    return Element("sphere", found.place(*x[:3]), found.residuals_mm, float(np.ptp(found.residuals_mm)),
                   radius_mm=float(x[3]), covariance=covariance, parameters=(*POINT, "radius_mm"),
                   iterations=found.iterations, stopped=found.stopped)  # fmt: skip


def circle(points_mm: Points) -> Element:
    """Circle in space: sum of squared distances in 3-D, at least 3 points; `point_mm` is its centre.

    `residuals_mm` are the signed radial ones; `zone_mm` is their span.
    """
    points = checked(points_mm, 3)
    found = least(CIRCLE, points)
    x, frame = found.parameters_mm, found.frame
    radial = found.residuals_mm[len(points) :]
    axis = signed(frame[2])
    derivative = np.zeros((7, 6))
    derivative[:6, :4] = _axis_derivative(frame, float(axis @ frame[2]))
    derivative[:3, 4], derivative[6, 5] = frame[2], 1.0
    return Element("circle", found.place(x[0], x[1], x[4]), radial, float(np.ptp(radial)), axis, float(x[5]),
                   covariance=type_a(found.jacobian, found.residuals_mm, derivative),
                   parameters=(*POINT, *DIRECTION, "radius_mm"), iterations=found.iterations,
                   stopped=found.stopped)  # fmt: skip


def cylinder(points_mm: Points) -> Element:
    """Cylinder through at least 5 points; `point_mm` is the centroid's foot on the axis."""
    points = checked(points_mm, 5)
    found = least(CYLINDER, points)
    x, frame = found.parameters_mm, found.frame
    axis = signed(frame[2])
    derivative = np.zeros((7, 5))
    derivative[:6, :4], derivative[6, 4] = _axis_derivative(frame, float(axis @ frame[2])), 1.0
    return Element("cylinder", found.place(x[0], x[1]), found.residuals_mm,
                   float(np.ptp(found.residuals_mm)), axis, float(x[4]),
                   covariance=type_a(found.jacobian, found.residuals_mm, derivative),
                   parameters=(*POINT, *DIRECTION, "radius_mm"), iterations=found.iterations,
                   stopped=found.stopped)  # fmt: skip


def cone(points_mm: Points) -> Element:
    """Cone through at least 6 points; `point_mm` is the centroid's foot on the axis, `radius_mm` the one there,
    `direction` the way in which it widens."""
    points = checked(points_mm, 6)
    found = least(CONE, points)
    x, frame = found.parameters_mm, found.frame
    way = -1.0 if x[5] < 0.0 else 1.0
    cosine, radius = float(np.cos(x[5])), float(x[4] / np.cos(x[5]))
    derivative = np.zeros((8, 6))
    derivative[:6, :4] = _axis_derivative(frame, way)
    derivative[6, 4:] = 1.0 / cosine, radius * np.tan(x[5])
    derivative[7, 5] = way * np.degrees(2.0)
    return Element("cone", found.place(x[0], x[1]), found.residuals_mm,
                   float(np.ptp(found.residuals_mm)), way * frame[2], radius, 2.0 * float(np.degrees(abs(x[5]))),
                   type_a(found.jacobian, found.residuals_mm, derivative),
                   (*POINT, *DIRECTION, "radius_mm", "apex_angle_deg"), found.iterations, found.stopped)  # fmt: skip


def _axis_derivative(frame: Array, way: float = 1.0) -> Array:
    """Point and direction (6, 4) by x, y and slopes in a frame whose third axis is the axis, told `way` round."""
    derivative = np.zeros((6, 4))
    derivative[:3, :2], derivative[3:, 2:] = frame[:2].T, way * frame[:2].T
    return derivative
