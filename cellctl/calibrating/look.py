"""Procedure camera: the artefact seen in both views. Raises Refused, CellError."""

from __future__ import annotations

import numpy as np

from cellctl.calibrating.camera import ViewPose, view_pose
from cellctl.calibrating.stand import VISION_S, Stand, camera_to, capture, prepare, present
from cellctl.steps.scan import Side
from cellctl.vision.spheres import sphere_fits


async def camera(stand: Stand, count: int) -> dict[Side, ViewPose]:
    """Poses of both views, each from `count` looks at the artefact."""
    await prepare(stand)
    await present(stand, stand.rotor, stand.shaft)
    found: dict[Side, ViewPose] = {}
    artefact = stand.calibration.artefact
    for side in ("rotor", "shaft"):
        await camera_to(stand, side)
        start = stand.calibration.views[side].matrix
        certified = np.array(artefact.rotor_side_mm if side == "rotor" else artefact.shaft_side_mm)
        looks = []
        for look in range(count):
            stand.tell(f"artefact in the {side} view, look {look + 1} of {count}")
            frame = await capture(stand, "artefact_rotor" if side == "rotor" else "artefact_shaft")
            asked = (frame.points_mm, start, certified, artefact.sphere_diameter_mm)
            looks.append(await stand.jobs.run(sphere_fits, *asked, latency_s=VISION_S))
        found[side] = view_pose(
            looks,
            certified,
            start,
            stand.calibration.scanner,
            sphere_diameter_mm=artefact.sphere_diameter_mm,
            certificate_mm=artefact.sigma_mm,
        )
    await camera_to(stand, "parked")
    return found
