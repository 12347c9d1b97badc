"""Readings that a calibration takes while everything stands: weight on the sensor, probes beside the mandrel."""

from __future__ import annotations

import asyncio

import numpy as np

from cellctl.calibrating.force import Weighed
from cellctl.calibrating.stand import Stand, move, where
from cellctl.vision.geometry import Array
from cellctl.vision.part import Refused
from hal.interfaces import GapProbe, Quality

SETTLE_S = 2.0
WEIGH_S = 1.0
PROBE_READS, PROBE_S = 16, 0.05


async def weigh(stand: Stand, mass_kg: float, at_mm: float) -> Weighed:
    """Readings at height `at_mm`, arrived at from below and from above."""
    await move(stand, "jack", at_mm)
    up = await _reading(stand)
    await move(stand, "jack", 2.0 * at_mm)
    await move(stand, "jack", at_mm)
    down = await _reading(stand)
    noise = float(np.sqrt(0.5 * (np.var(up, ddof=1) + np.var(down, ddof=1))))
    return Weighed(mass_kg, float(np.mean(up)), float(np.mean(down)), noise)


async def _reading(stand: Stand) -> Array:
    await asyncio.sleep(SETTLE_S)
    return (await stand.interlock.window(WEIGH_S)).samples_n


async def probes(stand: Stand) -> Array:
    """(3,) means of several readings of the gap probes, mm. Raises Refused where one does not measure."""
    await asyncio.sleep(SETTLE_S)
    devices: tuple[GapProbe, ...] = (stand.devices.gap_probe_1, stand.devices.gap_probe_2, stand.devices.gap_probe_3)
    read = []
    for _ in range(PROBE_READS):
        for probe in devices:
            reading = await probe.read()
            if reading.quality is not Quality.GOOD:
                at = (await where(stand)).z_mm
                raise Refused(
                    "out_of_range",
                    f"{probe.name} says {reading.value:g} mm ({reading.quality.value}) with the jack at {at:.0f} mm: "
                    "set the probes nearer, or centre the mandrel",
                )
            read.append(reading.value)
        await asyncio.sleep(PROBE_S)
    return np.asarray(np.array(read).reshape(-1, len(devices)).mean(axis=0))
