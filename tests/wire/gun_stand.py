"""A simulated controller and its backend. The socket holds nothing: a program turns freely until its time limit.

It then ends NOK, which is a result like any other.
"""

from __future__ import annotations

import asyncio
import contextlib
from collections.abc import AsyncIterator, Awaitable, Callable
from dataclasses import replace
from typing import Any

from hal.codec.open_protocol_trace import Order
from hal.entries import OpenProtocolEntry
from hal.errors import DeviceError
from hal.fake.devices.guns import install_joints
from hal.fake.faults import Fault, FaultBook
from hal.fake.wire.gun import GunController
from hal.fake.wire.gun_memory import Program, TurnProgram
from hal.real.gun import OpenProtocolGun
from tests.contract.backends import WireBackend, plant_of
from tests.contract.wire_gun import SNUG, installed

FREE = replace(SNUG, stage="free", timeout_s=2.0)
LONG = replace(SNUG, stage="long", timeout_s=8.0)
PROGRAMS: tuple[Program, ...] = (FREE, LONG, TurnProgram(90.0, 15.0, 5.0))
WIRE = WireBackend(installed, speed=200.0)
Case = Callable[[GunController, OpenProtocolGun], Awaitable[None]]


def entry_of(controller: GunController, **more: Any) -> OpenProtocolEntry:
    """The cell file's entry for `controller`."""
    return OpenProtocolEntry(kind="open_protocol", host="127.0.0.1", port=controller.port, **more)


@contextlib.asynccontextmanager
async def stand(
    *faults: Fault, connect: bool = True, order: Order = "big", **more: Any
) -> AsyncIterator[tuple[GunController, OpenProtocolGun]]:
    """A controller and its backend."""
    plant = plant_of("ideal")
    install_joints(plant)
    controller = GunController("gun_a", plant, FaultBook(faults), PROGRAMS, order=order)
    await controller.start()
    gun = OpenProtocolGun("gun_a", entry_of(controller, **more))
    try:
        if connect:
            await gun.connect()
        yield controller, gun
    finally:
        await gun.close()
        await controller.close()


def on_stand(case: Case, *faults: Fault, **more: Any) -> None:
    async def main() -> None:
        async with stand(*faults, **more) as (controller, gun):
            await case(controller, gun)

    WIRE.run(main())


async def linked(gun: OpenProtocolGun) -> None:
    """Wait until the link has come back by itself."""
    for _ in range(200):
        with contextlib.suppress(DeviceError):
            await gun.safe()
            return
        await asyncio.sleep(0.25)
    raise AssertionError("the link did not come back")
