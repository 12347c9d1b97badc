"""Procedure force: weights hung on the jack's sensor. Raises Refused, CellError."""

from __future__ import annotations

import math
from collections.abc import Sequence

from cellctl.calibrating.force import Force, Weighed, force_gain
from cellctl.calibrating.readings import weigh
from cellctl.calibrating.stand import NOTHING, Stand, move, prepare, present
from hal.units import GRAVITY_M_S2

WEIGHT = "CAL-WEIGHT-"
"""Serial number of a weight, with its mass in kilograms behind it."""
WEIGH_AT_MM = 5.0
LOADS = (0.0, 0.2, 0.4, 0.6, 0.8)
"""Shares of the sensor's range."""


def spread_masses(range_n: float) -> tuple[float, ...]:
    """Round masses (kg) that spread over a sensor's range and stay inside it with a gain a tenth off."""
    whole_kg = range_n / GRAVITY_M_S2
    step_kg = 10.0 ** (math.floor(math.log10(whole_kg)) - 1)
    return tuple(math.floor(share * whole_kg / step_kg) * step_kg for share in LOADS)


async def force(stand: Stand, masses_kg: Sequence[float], mass_sigma: float, range_n: float) -> Force:
    """Weights hung on the sensor."""
    await prepare(stand)
    weighed: list[Weighed] = []
    for mass in masses_kg:
        await present(stand, NOTHING, f"{WEIGHT}{mass:g}")
        stand.tell(f"weighing {mass:g} kg")
        weighed.append(await weigh(stand, mass, WEIGH_AT_MM))
        await move(stand, "jack", 0.0)
    return force_gain(weighed, range_n=range_n, mass_sigma=mass_sigma)
