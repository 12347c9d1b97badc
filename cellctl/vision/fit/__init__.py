"""Geometric elements by least squares of the orthogonal distance, and minimum zones. Points (N, 3) in millimetres."""

from cellctl.vision.fit.elements import circle, cone, cylinder, line, plane, sphere
from cellctl.vision.fit.result import Element, FitError
from cellctl.vision.fit.zone import circle_zone, cylinder_zone, plane_zone

__all__ = [
    "Element",
    "FitError",
    "circle",
    "circle_zone",
    "cone",
    "cylinder",
    "cylinder_zone",
    "line",
    "plane",
    "plane_zone",
    "sphere",
]
