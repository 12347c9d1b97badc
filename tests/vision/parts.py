"""Parts that the vision tests measure."""

from __future__ import annotations

from cellctl.vision.part import Part

SHAFT = Part(
    feature="hole",
    circle_diameter_mm=240.0,
    angles_deg=tuple(10.0 * i for i in range(36)),
    diameter_mm=(8.3,) * 36,
    chamfer_diameter_mm=9.9,
    chamfer_angle_deg=45.0,
    depth_mm=14.0,
    face_inner_diameter_mm=180.0,
    face_outer_diameter_mm=280.0,
    ledge_step_mm=5.0,
    flatness_limit_mm=0.05,
)

# another joint: other size, unequal angles, one larger hole
FLANGE = Part(
    feature="hole",
    circle_diameter_mm=150.0,
    angles_deg=(0.0, 40.0, 95.0, 150.0, 200.0, 260.0, 310.0),
    index_feature=0,
    diameter_mm=(12.4, 10.4, 10.4, 10.4, 10.4, 10.4, 10.4),
    chamfer_diameter_mm=13.6,
    chamfer_angle_deg=30.0,
    depth_mm=18.0,
    face_inner_diameter_mm=100.0,
    face_outer_diameter_mm=190.0,
    ledge_step_mm=3.0,
)
