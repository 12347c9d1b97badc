"""The Open Protocol backend on its simulator, whose parameter sets are those of the contract's cases."""

from __future__ import annotations

import contextlib
from collections.abc import AsyncIterator

from hal.entries import OpenProtocolEntry
from hal.fake.devices.guns import install_joints
from hal.fake.faults import FaultBook
from hal.fake.plant import Plant
from hal.fake.wire.gun import ESTOP_ALARM, GunController
from hal.fake.wire.gun_memory import Program, TurnProgram
from hal.interfaces import TighteningProgram
from hal.real.gun import OpenProtocolGun

SNUG = TighteningProgram(
    stage="snug",
    target_torque_nm=10.0,
    torque_low_nm=9.0,
    torque_high_nm=11.0,
    angle_low_deg=0.0,
    angle_high_deg=7200.0,
    threshold_torque_nm=6.0,
    speed_rpm=60.0,
    timeout_s=30.0,
)
PROGRAMS: tuple[Program, ...] = (
    SNUG,
    TurnProgram(-30.0, 10.0, 6.0),
    TurnProgram(720.0, 20.0, 6.0),
    TurnProgram(10.0, 10.0, 5.0),
    TurnProgram(90.0, 5.0, 5.0),
    TurnProgram(-90.0, 5.0, 5.0),
    TurnProgram(36_000.0, 60.0, 8.0),
    TurnProgram(3600.0, 5.0, 5.0),
)


@contextlib.asynccontextmanager
async def controller_of(
    name: str, plant: Plant, faults: FaultBook
) -> AsyncIterator[tuple[GunController, OpenProtocolGun]]:
    """A controller that listens, and a backend that is not connected."""
    install_joints(plant)
    controller = GunController(name, plant, faults, PROGRAMS)
    port = await controller.start()
    entry = OpenProtocolEntry(kind="open_protocol", host="127.0.0.1", port=port, estop_alarms=(ESTOP_ALARM,))
    gun = OpenProtocolGun(name, entry)
    try:
        yield controller, gun
    finally:
        await gun.close()
        await controller.close()


@contextlib.asynccontextmanager
async def installed(name: str, plant: Plant, faults: FaultBook) -> AsyncIterator[OpenProtocolGun]:
    """As the contract's cases want it."""
    async with controller_of(name, plant, faults) as (_, gun):
        yield gun
