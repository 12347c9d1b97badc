"""The Kolver backend on its simulator, whose programs are those of the contract's cases."""

from __future__ import annotations

import contextlib
from collections.abc import AsyncIterator, Sequence
from typing import Any

from hal.entries import KducerEntry
from hal.fake.devices.guns import install_joints
from hal.fake.faults import FaultBook
from hal.fake.plant import Plant
from hal.fake.wire.gun_memory import Program
from hal.fake.wire.kducer import KducerController
from hal.real.kducer import KducerGun
from tests.contract.wire_gun import PROGRAMS

LEVER_S = 0.6
"""On a quickened loop an exchange takes longer than in a hall."""


def entry_of(port: int, **more: Any) -> KducerEntry:
    """The cell file's entry for a controller on this machine."""
    return KducerEntry(**{"kind": "kducer", "host": "127.0.0.1", "port": port, "lever_s": LEVER_S} | more)


@contextlib.asynccontextmanager
async def controller_of(
    name: str, plant: Plant, faults: FaultBook, programs: Sequence[Program] = PROGRAMS, **more: Any
) -> AsyncIterator[tuple[KducerController, KducerGun]]:
    """A controller that listens on a free port, and a backend that is not connected."""
    install_joints(plant)
    anywhere = entry_of(1).model_copy(update={"port": 0})
    controller = KducerController(name, anywhere, plant, faults, programs)
    gun = KducerGun(name, entry_of(await controller.start(), **more))
    try:
        yield controller, gun
    finally:
        await gun.close()
        await controller.close()


@contextlib.asynccontextmanager
async def installed(name: str, plant: Plant, faults: FaultBook) -> AsyncIterator[KducerGun]:
    """As the contract's cases want it."""
    async with controller_of(name, plant, faults) as (_, gun):
        yield gun
