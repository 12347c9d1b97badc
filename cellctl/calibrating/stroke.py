"""The jack over its stroke: a mandrel rises past the gap probes, which stand on a bracket beside it."""

from __future__ import annotations

import numpy as np

from cellctl.calibrating.mandrel import Probed, centre_of
from cellctl.calibrating.readings import probes
from cellctl.calibrating.stand import NOTHING, Stand, guarded_jack, move, present, where
from cellctl.kinematics import AxesPosition

MANDREL = "CAL-MANDREL"
"""Serial number of the mandrel."""
HEIGHTS = 9
REVERSAL_DEG = (-90.0, 90.0)
PROBE_STEPS_MM = (-0.4, 0.4, 0.0)
WANDERED_MM = 0.2


async def stroke(stand: Stand, top_mm: float) -> list[Probed]:
    """The mandrel past the probes: the stage stepped below, then the stroke up to `top_mm` at two angles half a
    turn apart."""
    await present(stand, NOTHING, MANDREL)
    probed = []
    for turn in REVERSAL_DEG:
        await move(stand, "shaft_table", turn)
        middle = await _centred(stand, Probed(await where(stand), await probes(stand)))
        for name in ("stage_x", "stage_y"):
            for step in PROBE_STEPS_MM:
                await move(stand, name, (middle.x_mm if name == "stage_x" else middle.y_mm) + step)
                probed.append(Probed(await where(stand), await probes(stand)))
        for height in np.linspace(0.0, top_mm, HEIGHTS)[1:]:
            stand.tell(f"mandrel at table {turn:g} deg, jack {height:.0f} mm")
            await guarded_jack(stand, float(height))
            probed.append(Probed(await where(stand), await probes(stand)))
            await _centred(stand, probed[-1])
        await guarded_jack(stand, 0.0)
    return probed


async def _centred(stand: Stand, last: Probed) -> AxesPosition:
    """Bring a mandrel that has wandered off back to the middle of the probes, before it leaves their range."""
    aside = centre_of(last.gap_mm)
    if np.hypot(*aside) > WANDERED_MM and last.at.z_mm <= stand.free_mm:
        await move(stand, "stage_x", last.at.x_mm - float(aside[0]))
        await move(stand, "stage_y", last.at.y_mm - float(aside[1]))
    return await where(stand)
