"""An axis on a bus where frames are lost, doubled, late and cut in half at random."""

from __future__ import annotations

import asyncio

import numpy as np
import pytest

from hal.bus.hub import BusFault, Kind
from hal.codec.lawicel import CanFrame
from hal.errors import DeviceError, DeviceFault
from tests.contract.wire_axis import Wire
from tests.wire.test_axis import ROUNDS, on_wire


@pytest.mark.parametrize("seed", [0, 4, *(pytest.param(seed, marks=pytest.mark.nightly) for seed in range(5, 40))])
def test_under_a_storm_of_faults_it_arrives_or_says_why(seed: int) -> None:
    kinds: tuple[Kind, ...] = ("lost", "twice", "late", "half")

    async def case(wire: Wire) -> None:
        rng = np.random.default_rng(seed)

        def hit(frame: CanFrame) -> bool:
            return bool(rng.random() < 0.02)

        for _ in range(ROUNDS):
            wire.hub.faults[:] = [BusFault(kind, hit, count=3, delay_s=float(rng.uniform(0.0, 3.0))) for kind in kinds]
            target = float(rng.uniform(0.0, 60.0))
            try:
                state = await wire.axis.move_to(target, speed=20.0)
                if abs(state.position - target) > 0.01:  # its encoder says that it was stopped: as the cell judges
                    raise DeviceFault("reached is not true")
            except DeviceError:
                wire.hub.faults.clear()
                await asyncio.sleep(4.0)
                for _ in range(50):
                    try:
                        await wire.axis.halt()
                        break
                    except DeviceError:
                        await asyncio.sleep(0.2)
                assert (await wire.axis.safe()).safe
                here = (await wire.axis.read()).position
                await wire.axis.rearm()
                await asyncio.sleep(2.0)
                assert (await wire.axis.read()).position == here
        wire.hub.faults.clear()

    on_wire(case)
